"""Materials that vary from place to place."""
