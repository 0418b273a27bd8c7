"""Readers of cameras that other programs write, each in a file of its own. `assembly.py` has what they share."""

from __future__ import annotations

from blender_nep.capture.formats.peers import meshroom, opensfm, polycam, realityscan, visualsfm

PEERS = (realityscan, meshroom, opensfm, visualsfm, polycam)
"""The readers, in the order in which they are asked"""
