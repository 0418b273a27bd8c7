"""Which faces the photos show: balls, for which visibility has a closed form."""

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture import PixelRays, load_capture
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.shown_faces import shown_faces
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
    return shown_faces(surface, RayTracer(surface.vertices, surface.faces), rays)


def cameras_of(rays: PixelRays) -> np.ndarray:
    return np.stack([rays.camera(view)[0].numpy() for view in range(rays.views)])


@pytest.mark.parametrize("photos", [FirstView, lambda rays: rays])
def test_a_face_of_a_ball_is_shown_if_a_camera_is_above_its_plane(rays, photos):
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
