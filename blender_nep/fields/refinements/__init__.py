"""What improves stage 1 between its steps, one file each."""
