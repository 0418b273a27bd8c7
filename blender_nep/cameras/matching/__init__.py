"""What runs in the process of pycolmap: features, matching, mapping and adjustment."""
