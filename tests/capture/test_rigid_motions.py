"""Motions of the object of a turntable: known from the camera's frames, without the axis."""

import torch

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.capture.rays.rigid_motions import RigidMotions


def rotations(count: int) -> torch.Tensor:
    """Random rotations [count, 3, 3] without a reflection."""
    q, _ = torch.linalg.qr(torch.randn(count, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
    return q * torch.linalg.det(q)[:, None, None]


def turned_object() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Motions of an object (rotation, offset; the first is the identity) and the frames of its still camera in its frame."""
    turn, shift = rotations(5), 0.1 * torch.randn(5, 3, dtype=torch.float64)
    turn[0], shift[0] = torch.eye(3), 0
    camera, place = rotations(9)[8], torch.tensor([0.5, -3.0, 1.0], dtype=torch.float64)
    return turn, shift, turn.mT @ camera, torch.einsum("nij,ni->nj", turn, place - shift)


def test_a_still_camera_tells_how_the_object_moved() -> None:
    turn, shift, rotation, origin = turned_object()
    motions = RigidMotions.of_still_camera(rotation, origin)
    assert torch.allclose(motions.rotation, turn) and torch.allclose(motions.offset, shift)


def test_other_photos_get_the_room_of_the_first() -> None:
    turn, shift, rotation, origin = turned_object()
    motions = RigidMotions.of_still_camera(rotation[2:], origin[2:], (rotation[0], origin[0]))
    assert torch.allclose(motions.rotation, turn[2:]) and torch.allclose(motions.offset, shift[2:])


def test_rays_of_a_still_camera_are_the_same_in_the_room() -> None:
    _, _, rotation, origin = turned_object()
    seen = torch.nn.functional.normalize(torch.randn(3, dtype=torch.float64), dim=0)
    motions = RigidMotions.of_still_camera(rotation, origin)
    room = RayBundle(origin, rotation @ seen, torch.ones(5), motions).in_room()
    assert torch.allclose(room.origins, origin[0].expand(5, 3))
    assert torch.allclose(room.directions, (rotation[0] @ seen).expand(5, 3))
    assert room.motion is None


def test_points_along_a_direction_move_with_it() -> None:
    turn, shift, _, _ = turned_object()
    motions = RigidMotions(turn, shift)
    points, directions = torch.randn(2, 5, 4, 3, dtype=torch.float64)
    along = motions.points(points) + 2 * motions.directions(directions)
    assert torch.allclose(motions.points(points + 2 * directions), along)


def test_chosen_rays_keep_their_own_motions() -> None:
    turn, shift, rotation, origin = turned_object()
    rays = RayBundle(origin, rotation[:, :, 2], torch.ones(5), RigidMotions(turn, shift))
    index = torch.tensor([3, 1])
    assert torch.equal(rays[index].in_room().origins, rays.in_room().origins[index])
