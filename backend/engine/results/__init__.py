"""Reads what the engine and captures have on the disk. No bpy here."""
