"""Runs commands of the engine beside a job, without blocking Blender. No bpy here."""
