"""Scores an asset against ground truth: geometry, materials, F_e, cameras, relighting."""
