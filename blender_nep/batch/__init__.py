"""Makes assets of many captures: each one in a process of its own, as many at once as cores and memory allow."""
