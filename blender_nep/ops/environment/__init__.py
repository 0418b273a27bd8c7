"""The kernels of the environment field: volume rendering, cones, prefilter."""
