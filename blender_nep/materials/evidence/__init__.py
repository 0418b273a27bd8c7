"""What tells the roughness or the class of a material: one file each, and `decision`, which joins what they say."""
