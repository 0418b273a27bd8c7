"""Who runs the jobs of a batch, when, and with what."""
