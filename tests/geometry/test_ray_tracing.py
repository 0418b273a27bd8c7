"""The ray tracer against a sphere's closed form and its own interpolation."""

import numpy as np
import pytest
import trimesh

from blender_nep.geometry.ray_tracing import RayTracer


@pytest.fixture(scope="module", params=[1.0, 1e-3, 1e4])
def sphere(request):
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=request.param)
    return RayTracer(mesh.vertices, mesh.faces), request.param, mesh


def random_rays(n, radius, seed=0):
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(n, 3))
    origins *= 3 * radius / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.normal(size=(n, 3)) * radius * 0.7 - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_hits_match_the_sphere(sphere):
    tracer, radius, mesh = sphere
    o, d = random_rays(100_000, radius)
    t, face, barycentric = tracer.intersect(o, d)
    b = (o * d).sum(1)
    squared = b * b - (o * o).sum(1) + radius**2
    clear = np.abs(squared) > 0.01 * radius**2  # the polyhedron differs from the sphere at the silhouette
    assert ((face >= 0) == (squared > 0))[clear].all()
    hit = clear & (squared > 0)
    expected = -b - np.sqrt(np.maximum(squared, 0))
    assert np.abs(t - expected)[hit].max() < 5e-3 * radius
    points = np.einsum("nc,nck->nk", barycentric[hit], mesh.vertices[mesh.faces[face[hit]]])
    assert np.abs(points - (o + d * t[:, None])[hit]).max() < 2e-5 * radius
    assert np.isinf(t[face < 0]).all() and (barycentric[face < 0] == 0).all()
    assert (tracer.occluded(o, d) == (face >= 0)).all()


def test_smooth_normals_are_the_spheres(sphere):
    tracer, radius, mesh = sphere
    o, d = random_rays(2000, radius, 1)
    t, face, barycentric = tracer.intersect(o, d)
    hit = face >= 0
    normal = tracer.smooth_normals(mesh.vertices / radius, face[hit], barycentric[hit])
    points = (o + d * np.where(hit, t, 0)[:, None])[hit]
    assert np.abs(normal - points / np.linalg.norm(points, axis=1, keepdims=True)).max() < 1e-3


def test_rays_leave_a_convex_surface_without_meeting_it(sphere):
    tracer, radius, _ = sphere
    o, d = random_rays(50_000, radius, 2)
    _, face, barycentric = tracer.intersect(o, d)
    face, barycentric = face[face >= 0], barycentric[face >= 0]
    points = tracer.interpolate(tracer.vertices, face, barycentric)
    away = np.random.default_rng(3).normal(size=points.shape)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    cosine = (away * tracer.face_normals[face]).sum(1)
    outward = cosine > 1e-3
    start = tracer.leave(points, face, away)
    assert not tracer.occluded(start[outward], away[outward]).any()
    assert tracer.occluded(start[cosine < -1e-2], away[cosine < -1e-2]).all()


def test_empty_meshes_and_vertices_not_finite_are_refused():
    with pytest.raises(ValueError, match="at least one triangle"):
        RayTracer(np.zeros((3, 3)), np.zeros((0, 3), int))
    with pytest.raises(ValueError, match="not finite"):
        RayTracer(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
