"""Whole small jobs on hostile captures (docs/stress.md)."""
