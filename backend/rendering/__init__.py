"""Relit comparisons and turntables in Cycles."""
