"""Captures with ground truth: scenes, random scenes, photos as a phone takes them."""
