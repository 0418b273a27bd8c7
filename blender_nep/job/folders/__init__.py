"""The folders of a job: `job/` and `checkpoints/`."""
