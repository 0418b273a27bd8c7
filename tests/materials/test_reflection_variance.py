"""A pixel shows a piece of the surface, in which the mirrored direction varies."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.samples.light_gathering import Observations
from blender_nep.materials.samples.photo_samples import edges_and_reflection_variance
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import Material, reflected
from support import lit_ball

WIDTH = 0.004
"""Angle across a pixel [radians]"""
HEIGHT = 3.0
"""Of the camera over the origin"""


def seen(mesh: trimesh.Trimesh, across: float) -> tuple[bool, float]:
    """Whether there is an edge, and the variance, in the pixel that sees the point `across` beside the axis.

    The camera is HEIGHT above the origin.
    """
    tracer = RayTracer(mesh.vertices, mesh.faces)
    origin = np.array([[0, 0, HEIGHT]])
    depth, _, _ = tracer.intersect(np.array([[across, 0, HEIGHT]]), np.array([[0, 0, -1.0]]))
    direction = np.array([[across, 0, -depth[0]]])
    direction /= np.linalg.norm(direction)
    t, face, barycentric = tracer.intersect(origin, direction)
    normals = np.asarray(mesh.vertex_normals)
    smooth = tracer.smooth_normals(normals, face, barycentric)
    cosine = -(smooth * direction).sum(1)
    half_angle, on = np.array([WIDTH / pixel_width(1.0)]), np.ones(1, bool)
    edge, variance = edges_and_reflection_variance(tracer, normals, origin, direction, t, half_angle, smooth, cosine, on)
    return bool(edge[0]), float(variance[0])


@pytest.mark.parametrize("across", [0.0, 0.2, 0.35])
def test_on_a_ball_it_is_that_of_a_convex_mirror(across):
    radius = 0.5
    place = np.array([across, 0, np.sqrt(radius**2 - across**2)])
    ray = place - [0, 0, HEIGHT]
    distance = np.linalg.norm(ray)
    cosine = -(ray / distance) @ (place / radius)
    # Coddington's equations: how far the mirrored direction turns with the ray, in the plane of incidence and across it.
    in_plane, out_of_plane = 1 + 2 * distance / (radius * cosine), 1 + 2 * distance * cosine / radius
    edge, variance = seen(trimesh.creation.icosphere(6, radius), across)
    assert not edge
    assert variance == pytest.approx(WIDTH**2 * (in_plane**2 + out_of_plane**2) / 24, rel=0.01)


def plane(rise: float = 0.0, end: float = 1.0) -> trimesh.Trimesh:
    """Two rectangles that meet at x = 0, each with normals of its own. The right one rises by `rise` up to x = `end`."""
    left, right = [[-1, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0]], [[0, -1, 0], [end, -1, rise], [end, 1, rise], [0, 1, 0]]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    return trimesh.Trimesh([*left, *right], faces, process=False)


@pytest.mark.parametrize("across", [0.1, 0.5])
def test_on_a_plane_the_mirror_direction_turns_only_with_the_ray(across):
    edge, variance = seen(plane(), across)
    assert not edge and variance == pytest.approx(WIDTH**2 / 12, rel=0.01)


@pytest.mark.parametrize("pixels", [0.7, 1.9, 2.1])
def test_a_crease_beside_the_pixel_does_not_count(pixels):
    _, variance = seen(plane(rise=0.4), pixels * WIDTH * HEIGHT)
    assert WIDTH**2 / 12 < 1.01 * variance < 1.5**2 * WIDTH**2 / 12


def test_there_is_an_edge_where_a_neighbor_misses_the_mesh():
    edge, variance = seen(plane(end=0.5), 0.5 - WIDTH * HEIGHT)
    assert edge and np.isfinite(variance)


def test_predicted_reflections_are_as_blurred_as_those_in_photos(monkeypatch):
    """Brute force: the rays of each pixel of the photos are spread over it."""
    monkeypatch.setattr(lit_ball, "HALF_ANGLE", 0.012)
    environment = lit_ball.AnalyticEnvironment()
    environment.sharpness = environment.sharpness * 20
    photos = lit_ball.make_photos(lit_ball.constant((1.0, 1.0, 1.0), 0.05, 1.0), 4, rays=400, environment=environment)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=lit_ball.RADIUS)
    vertices = np.asarray(mesh.vertices)
    surface = Surface(vertices, np.asarray(mesh.faces), vertices / lit_ball.RADIUS)
    observed = Observations.of(surface, environment, lit_ball.lit_scene(photos), lit_ball.PRESET, 0)

    def error(variance):
        light = IncomingLight.gathered(
            observed.f_p, observed.points, (0.03, 0.05, 0.1), 8, variance, torch.Generator().manual_seed(1), lambda _: None
        )
        one = torch.ones(len(observed.points))
        mirror = Material(torch.ones(len(one), 3), 0.05 * one, one)
        predicted = reflected(mirror, light.moments(mirror.roughness), light.diffuse, light.cos_v)
        return float((predicted - observed.samples.radiance).abs().mean() / observed.samples.radiance.mean())

    variance = observed.samples.reflection_variance
    assert error(variance) < 0.5 * error(0 * variance)
    assert error(variance) < 0.75 * min(error(variance / 2), error(2 * variance))
