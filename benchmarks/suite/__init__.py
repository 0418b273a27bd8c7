"""Plans and runs the benchmark: captures, variants, steps, rows."""
