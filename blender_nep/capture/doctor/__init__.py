"""The doctor: what is wrong with a capture, and what `blender-nep info` says about it."""
