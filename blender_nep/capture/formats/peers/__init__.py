"""Readers of cameras that other programs write, each in a file of its own. `assembly.py` has what they share."""

from __future__ import annotations

from blender_nep.capture.formats.peers import (
    gaussians,
    meshroom,
    mvsnet,
    nero,
    openmvg,
    opensfm,
    polycam,
    realityscan,
    realityscan_xmp,
    record3d,
    sdfstudio,
    visualsfm,
)

PEERS = (
    *(realityscan, realityscan_xmp, meshroom, opensfm, visualsfm, openmvg, polycam, record3d),
    *(sdfstudio, mvsnet, nero, gaussians),
)
"""The readers, in the order in which they are asked. The cameras of `gaussians` are copies of those of another program"""
