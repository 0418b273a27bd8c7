"""A pixel shows a piece of the surface, in which the mirrored direction varies."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture.pixel_width import pixel_width
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.light_gathering import Observations
from blender_nep.materials.photo_samples import _across_pixels
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import Material, reflected
from support import lit_ball

WIDTH = 0.004
"""Angle across a pixel [radians]"""
HEIGHT = 3.0
"""Of the camera over the origin"""


def variance_of(mesh: trimesh.Trimesh, across: float) -> float:
    """The variance in the pixel that sees the point `across` beside the axis, from HEIGHT above the origin."""
    tracer = RayTracer(mesh.vertices, mesh.faces)
    origin = np.array([[0, 0, HEIGHT]])
    depth, _, _ = tracer.intersect(np.array([[across, 0, HEIGHT]]), np.array([[0, 0, -1.0]]))
    direction = np.array([[across, 0, -depth[0]]])
    direction /= np.linalg.norm(direction)
    t, face, barycentric = tracer.intersect(origin, direction)
    normals = np.asarray(mesh.vertex_normals)
    cosine = -(tracer.smooth_normals(normals, face, barycentric) * direction).sum(1)
    half_angle = np.array([WIDTH / pixel_width(1.0)])
    edge, variance = _across_pixels(tracer, normals, origin, direction, t, half_angle, cosine, np.ones(1, bool))
    assert not edge[0]
    return float(variance[0])


@pytest.mark.parametrize("across", [0.0, 0.2, 0.35])
def test_on_a_ball_it_is_that_of_a_convex_mirror(across):
    radius = 0.5
    place = np.array([across, 0, np.sqrt(radius**2 - across**2)])
    ray = place - [0, 0, HEIGHT]
    distance = np.linalg.norm(ray)
    cosine = -(ray / distance) @ (place / radius)
    # Coddington's equations: the mirrored direction turns with the ray, and by twice the turn of the normal.
    in_plane, out_of_plane = 1 + 2 * distance / (radius * cosine), 1 + 2 * distance * cosine / radius
    expected = WIDTH**2 * (in_plane**2 + out_of_plane**2) / 24
    assert variance_of(trimesh.creation.icosphere(6, radius), across) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("across", [0.0, 0.5])
def test_on_a_plane_the_mirrored_direction_turns_only_with_the_ray(across):
    plane = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    assert variance_of(plane, across) == pytest.approx(WIDTH**2 / 12, rel=0.01)


def test_predicted_reflections_are_as_blurred_as_those_in_photos(monkeypatch):
    """Brute force: the rays of each pixel of the photos are spread over it."""
    monkeypatch.setattr(lit_ball, "HALF_ANGLE", 0.012)
    environment = lit_ball.AnalyticEnvironment()
    environment.sharpness = environment.sharpness * 20
    photos = lit_ball.make_photos(lit_ball.constant((1.0, 1.0, 1.0), 0.05, 1.0), 4, rays=1000, environment=environment)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=lit_ball.RADIUS)
    vertices = np.asarray(mesh.vertices)
    surface = Surface(vertices, np.asarray(mesh.faces), vertices / lit_ball.RADIUS)
    seen = Observations.of(surface, environment, photos, lit_ball.PRESET, 0, torch.device("cpu"))

    def error(variance):
        light = IncomingLight.gathered(
            seen.f_p, seen.points, (0.03, 0.05, 0.1), 8, torch.Generator().manual_seed(1), lambda _: None, variance
        )
        one = torch.ones(len(seen.points))
        mirror = Material(torch.ones(len(one), 3), 0.05 * one, one)
        predicted = reflected(mirror, light.moments(mirror.roughness), light.diffuse, light.cos_v)
        return float((predicted - seen.samples.radiance).abs().mean() / seen.samples.radiance.mean())

    variance = seen.samples.reflection_variance
    assert error(variance) < 0.5 * error(None)
    assert error(variance) < 0.75 * min(error(variance / 2), error(2 * variance))
