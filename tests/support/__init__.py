"""Helpers that several tests share: small captures, played engines, processes with Blender."""
