"""The mesh (`Surface`), ray tracing with Embree, the raster of the UV map."""
