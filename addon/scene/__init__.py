"""What the add-on puts into the artist's scene and .blend file: bounds, previews, results, pictures, a shelf's objects."""
