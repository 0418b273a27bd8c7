"""Photo samples: the pixels from which materials are learned, and the light on them."""
