"""The commands beside `reconstruct`: the search for cameras, and the correction of materials."""
