"""Photos from a video: it is opened with care, and its sharpest frames, evenly spaced in view, are written."""
