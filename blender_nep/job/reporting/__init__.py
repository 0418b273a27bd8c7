"""What a job says while it runs: events, progress, previews."""
