"""What a surface point reflects: the BRDF, cones, the light that arrives (f_p), the light that no photo shows."""
