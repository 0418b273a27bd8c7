"""Photos from a turntable: the object turns, while the camera and the light stand still."""
