"""The ball of waves: its steepness, and the score of a smooth ball and of an exact one."""

import numpy as np
import pytest
import trimesh

from benchmarks.studies.relief import STEEPNESS, ball, score
from blender_nep.geometry.mesh import Surface


def as_surface(mesh):
    vertices, normals = (np.array(part, np.float64) for part in (mesh.vertices, mesh.vertex_normals))
    return Surface(vertices, np.array(mesh.faces), normals)


@pytest.mark.slow
def test_the_score_tells_a_lost_band_from_one_that_is_there():
    truth = ball(subdivisions=7)
    polar = np.degrees(np.arccos(truth.vertices[:, 2] / np.linalg.norm(truth.vertices, axis=1)))
    exact = score(as_surface(truth), truth, polar)
    assert max(exact.values()) < 0.5
    radius = np.linalg.norm(truth.vertices, axis=1)
    azimuth = np.arctan2(truth.vertices[:, 1], truth.vertices[:, 0])
    base = 0.95 * (1 - 0.1 * np.cos(2 * np.radians(polar)) - 0.04 * np.cos(3 * azimuth) * np.sin(np.radians(polar)) ** 3)
    smooth = trimesh.Trimesh(truth.vertices * (base / radius)[:, None], truth.faces, process=False)
    lost = score(as_surface(smooth), truth, polar)
    assert lost["smooth"] < 0.5
    # the waves are sin(x) sin(y): the mean over a period is summed up here
    steepest = 2 * np.pi * STEEPNESS
    x, y = np.meshgrid(*[np.linspace(0, 2 * np.pi, 400, endpoint=False)] * 2)
    mean = np.degrees(np.arctan(steepest * np.hypot(np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)))).mean()
    assert lost["0.16"] == pytest.approx(mean, rel=0.1)
