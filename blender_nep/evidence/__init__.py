"""What photos show of a point: which photos, in what color, and whether they agree."""
