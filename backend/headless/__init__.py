"""The two ways of `run.py`: one object, or a shelf of objects."""
