"""The hot kernels: Numba for the CPU, and plain torch beside those of stage 1, with one signature."""
