"""The kernels of material learning: fits of albedos, sums over lobes, transport of cones."""
