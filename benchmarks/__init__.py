"""Accuracy against time: `python -m benchmarks --help`. docs/benchmarks.md has the results."""
