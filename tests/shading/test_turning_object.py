"""f_p where the object turned and the light stood still, and materials that are learned from such photos."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading.plenoptic import PlenopticFunction, PlenopticSettings, SurfacePoints, TerminalRadiance
from blender_nep.shading.smooth_irradiance import IrradianceMean
from support.lit_ball import AnalyticEnvironment, constant, learn, make_photos, unwrapped_ball
from support.turns import turned_about_z

RADIUS = 0.5


def mirror_ball() -> PlenopticFunction:
    """f_p of a ball at the center."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    settings = PlenopticSettings(levels=1, diffuse=4, specular=4)
    light = AnalyticEnvironment()
    return PlenopticFunction(RayTracer(vertices, faces), vertices / RADIUS, light, TerminalRadiance(), settings, "cpu")


def seen_points(f_p: PlenopticFunction, motion: RigidMotions | None, count: int) -> SurfacePoints:
    """Points in the middle of `count` faces, seen from straight above them."""
    face = np.arange(count) * 7
    view = torch.from_numpy(f_p.tracer.face_normals[face]).float()
    return f_p.points(face, np.full((count, 3), 1 / 3, np.float32), view, motion)


def test_a_mirror_ball_that_turns_shows_a_light_that_is_still() -> None:
    f_p, motion = mirror_ball(), turned_about_z([0.05 * k for k in range(100)], axis=(0.1, 0.0))
    points = seen_points(f_p, motion, 100)
    angle = torch.full((100,), 0.02)
    traced = f_p.trace(points, points.normal, angle)
    expected, _ = AnalyticEnvironment().query_cone(None, motion.directions(points.normal), angle)
    torch.testing.assert_close(traced.radiance, expected, rtol=1e-4, atol=1e-5)
    still = f_p.trace(replace(points, motion=None), points.normal, angle).radiance
    assert (still - expected).abs().mean() > 0.05


def test_chosen_and_joined_points_keep_their_motions() -> None:
    f_p, motion = mirror_ball(), turned_about_z([0.3 * k for k in range(6)], axis=(0.2, 0.1))
    points = seen_points(f_p, motion, 6)
    first, rest = points[torch.tensor([4, 1])], points[torch.tensor([0])]
    joined = SurfacePoints.joined([first, rest])
    torch.testing.assert_close(joined.room_position, points.room_position[[4, 1, 0]])
    torch.testing.assert_close(joined.in_room(joined.normal), points.in_room(points.normal)[[4, 1, 0]])


def test_irradiance_is_averaged_over_one_side_in_the_room() -> None:
    f_p = mirror_ball()
    one = seen_points(f_p, None, 1)
    times = 40
    points = SurfacePoints.joined([one] * times)
    half = torch.arange(times) % 2 == 1
    turned = replace(points, motion=turned_about_z([math.pi / 2 * float(k) for k in half]))
    sideways = replace(turned, normal=torch.tensor([[1.0, 0.0, 0.0]]).expand(times, 3))
    lit = half.float()[:, None].expand(times, 3)
    torch.testing.assert_close(IrradianceMean.over(sideways)(lit), lit)


@pytest.mark.slow
def test_materials_are_found_on_an_object_that_turns_in_light() -> None:
    turntable = turned_about_z([0.6 * k for k in range(10)])
    photos = make_photos(constant([0.7, 0.3, 0.1], 0.3, 0.0), turntable=turntable)
    found = learn(unwrapped_ball(), photos)
    misled = learn(unwrapped_ball(), replace(photos, turntable=None))
    errors = [np.abs(each.albedo - np.array([0.7, 0.3, 0.1])).mean() for each in (found, misled)]
    assert errors[0] < 0.02 and errors[0] < 0.5 * errors[1]
    assert abs(float(np.median(found.roughness)) - 0.3) < 0.03
    assert found.metallic.max() < 0.5
    assert found.report["skipped"]["object gains"]["code"] == "reason.object_turned"
