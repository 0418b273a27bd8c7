"""Motions of an object on a turntable."""

import math

import torch

from blender_nep.capture.rays.rigid_motions import RigidMotions


def turned_about_z(angles: list[float], axis: tuple[float, float] = (0.0, 0.0)) -> RigidMotions:
    """The motions after turns by these angles in radians, about a vertical axis through the point `axis` [x, y]."""
    rotation = torch.tensor([[[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]] for a in angles])
    center = torch.tensor([*axis, 0.0])
    return RigidMotions(rotation, center - rotation @ center)
