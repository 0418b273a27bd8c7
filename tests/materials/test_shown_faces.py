"""Which faces the photos show: balls, for which visibility has a closed form."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture import PixelRays, load_capture
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials import shown_faces
from blender_nep.materials.shown_faces import ShownParts
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True, torch.device("cpu"))


class FirstView:
    """The first photo of some photos."""

    views = 1

    def __init__(self, rays: PixelRays) -> None:
        self.radiance, self.project, self.camera = rays.radiance, rays.project, rays.camera


def shown_by(meshes: list[trimesh.Trimesh], rays: PixelRays) -> np.ndarray:
    mesh = trimesh.util.concatenate(meshes)
    surface = Surface(mesh.vertices.astype(np.float32), mesh.faces, mesh.vertex_normals.astype(np.float32))
    return ShownParts.of(surface, RayTracer(surface.vertices, surface.faces), rays).at(*centers(len(surface.faces)))


def centers(faces: int) -> tuple[np.ndarray, np.ndarray]:
    """The places `ShownParts.at` asks for: the center of each face."""
    return np.arange(faces), np.full((faces, 3), 1 / 3, np.float32)


def cameras_of(rays: PixelRays) -> np.ndarray:
    return np.stack([rays.camera(view)[0].numpy() for view in range(rays.views)])


@pytest.mark.parametrize("photos", [FirstView, lambda rays: rays])
def test_a_face_of_a_ball_is_shown_to_a_camera_above_its_plane(rays, photos):
    rays = photos(rays)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    above = cameras_of(rays) @ ball.face_normals.T - (ball.triangles_center * ball.face_normals).sum(1)
    shown = shown_by([ball], rays)
    assert shown.all() == (rays.views > 1), "one camera sees less than a half"
    assert np.array_equal(shown, (above > 0).any(0))


def test_a_ball_inside_another_is_not_shown(rays):
    inner, outer = (trimesh.creation.icosphere(subdivisions=3, radius=radius) for radius in (0.2, 0.6))
    shown = shown_by([inner, outer], rays)
    assert not shown[: len(inner.faces)].any() and shown[len(inner.faces) :].any()


def test_what_lies_beside_the_frame_is_not_shown(rays):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    ball.apply_translation(50 * np.array([0.0, 0.0, 1.0]))
    assert not shown_by([ball], rays).any()


def test_a_photo_shows_a_part_of_a_large_face(rays):
    """A wall of two faces, half of which lies in the shadow of a smaller wall before a single camera."""
    camera = cameras_of(rays)[0]
    towards = camera / np.linalg.norm(camera)
    side = np.cross(towards, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, towards)

    def wall(at: np.ndarray, left: float, right: float, height: float) -> trimesh.Trimesh:
        corners = [at + x * side + z * height * up for x, z in ((left, -1), (right, -1), (right, 1), (left, 1))]
        return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)

    mesh = trimesh.util.concatenate([wall(0 * camera, -0.6, 0.6, 0.3), wall(0.3 * towards, -0.7, 0.0, 0.6)])
    if mesh.face_normals[0] @ towards < 0:
        mesh.invert()
    surface = Surface(mesh.vertices.astype(np.float32), mesh.faces, mesh.vertex_normals.astype(np.float32))
    parts = ShownParts.of(surface, RayTracer(surface.vertices, surface.faces), FirstView(rays))
    random = np.random.default_rng(0)
    face, barycentric = random.integers(2, size=5000), random.dirichlet([1, 1, 1], size=5000)
    place = np.einsum("nc,nck->nk", barycentric, surface.vertices[surface.faces[face]])
    # a ray from the place to the camera meets the plane of the smaller wall in its left half, or not
    along = (0.3 - place @ towards) / ((camera - place) @ towards)
    meets = (place + along[:, None] * (camera - place)) @ side
    clear = np.abs(meets) > 0.03  # nearer than a part
    assert np.array_equal(parts.at(face, barycentric)[clear], meets[clear] > 0) and 1000 < (meets[clear] > 0).sum() < 4000


@pytest.mark.parametrize("most", [500_000, 300])
def test_each_part_of_a_face_is_found_by_its_center(monkeypatch, most):
    monkeypatch.setattr(shown_faces, "_MOST", most)
    vertices = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.01, 0], [0.03, 0, 0], [0.3, 0.3, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 3, 2], [1, 4, 2]])
    edge_parts, face, barycentric = shown_faces._parts(Surface(vertices, faces, np.zeros_like(vertices)))
    assert len(face) == (edge_parts**2).sum() <= most and edge_parts[1] == 1 and edge_parts.max() > 5
    assert (barycentric > 0).all() and np.allclose(barycentric.sum(1), 1)
    marks = np.random.default_rng(1).random(len(face)) < 0.5
    parts = ShownParts(edge_parts, marks)
    assert np.array_equal(parts.at(face, barycentric), marks)
    # the corners of a face, too, where rounding may leave barycentric coordinates just below 0
    corners = np.eye(3)[np.arange(9) % 3] - 1e-9
    assert parts.at(np.arange(9) // 3, corners).shape == (9,)
