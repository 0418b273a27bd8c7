"""What tells the roughness or the class of a material, beside the residual."""
