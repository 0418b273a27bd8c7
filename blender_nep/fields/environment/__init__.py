"""The environment field F_e: its grid, its prefilter, and the steps in which it is learned alone."""
