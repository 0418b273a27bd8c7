"""Label pixels: which material lies at which place of the surface."""
