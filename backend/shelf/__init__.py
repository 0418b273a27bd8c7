"""The objects of a batch in a scene: the row, the asset marks, the catalog file."""
