"""Runs one job from a capture to an asset: stages, checkpoints, events, report. `runner.run` is the entry."""
