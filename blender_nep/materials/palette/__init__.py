"""The palette: the few materials that explain the photos, and their search."""
