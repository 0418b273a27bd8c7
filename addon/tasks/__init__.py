"""Work in other processes that Blender follows: jobs, batches, searches, checks, renders, installations.

A kind of work is a file with a subclass of `Task` (registry.py). The registry starts, polls, keeps and forgets tasks.
"""
