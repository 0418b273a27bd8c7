"""The kernels of the object field: the B-spline of the SDF, encodings, rendering of a surface."""
