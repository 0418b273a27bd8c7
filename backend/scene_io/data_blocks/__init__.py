"""What the import of an asset finds in the .blend file: images of the same files, and the artist's selection."""
