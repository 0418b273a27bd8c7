"""What a job knows of its scene: an analysis of the photos, and one of the mesh."""
