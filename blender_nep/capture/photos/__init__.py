"""Photos: reads their files as linear radiance."""
