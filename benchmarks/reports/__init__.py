"""Writes tables, plots and pictures from the rows of finished runs."""
