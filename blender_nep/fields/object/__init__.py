"""The object field F_o: its SDF, its colors, and their rendering."""
