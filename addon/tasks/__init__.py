"""Work in other processes that Blender follows: jobs, batches, searches, checks, renders, installations."""
