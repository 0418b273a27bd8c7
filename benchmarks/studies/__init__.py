"""Campaigns of their own: skipping, scaling, relief, clusters, node counts of rays."""
