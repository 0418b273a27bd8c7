"""A printed plate turns with the object. It is told from the object, and from a plain plate, by its print."""

import numpy as np
import pytest
import torch

from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.fields.still_silhouettes import LOWEST_SHARE, still_silhouettes
from blender_nep.fields.visual_hull import carve, score_cells
from blender_nep.support.plane import Support
from blender_nep.support.plate_print import plate_print
from blender_nep.tone_mapping import tone_map
from support import turning_ball
from support.table_scene import pattern
from support.turning_ball import BALL, HEIGHT, PLACE, PLATE

PLANE = Support(np.array([0.0, 0.0, 1.0]), HEIGHT)
AXIS = (np.arange(48) + 0.5) / 24 - 1
CELLS = np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1)
BALL_SDF = (np.linalg.norm(CELLS - PLACE, axis=-1) - BALL).astype(np.float32)


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    return turning_ball.turning_ball(tmp_path_factory.mktemp("printed"), "printed")[0]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return turning_ball.turning_ball(tmp_path_factory.mktemp("plain"), "plain")[0]


def overlap(maps: list[torch.Tensor], rays) -> float:
    """The intersection over union of the hull and the ball, above the plate."""
    hull = carve(score_cells(rays, maps, 48, LOWEST_SHARE))
    above = PLANE.distance(CELLS) > 0
    found, true = (hull.sdf < 0) & above, (BALL_SDF < 0) & above
    assert (found & true).sum() / true.sum() > 0.97, "nothing of the ball is lost"
    return (found & true).sum() / (found | true).sum()


def test_the_print_is_no_part_of_the_object(printed):
    assert overlap(still_silhouettes(printed), printed) < 0.6
    assert overlap(still_silhouettes(printed, PLANE), printed) > 0.8


@pytest.mark.parametrize("kind", [pytest.param("printed", marks=pytest.mark.slow), "plain"])
def test_a_wide_plate_turns_beside_the_sphere_too(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(turning_ball, "PLATE", 2.0)
    rays = turning_ball.turning_ball(tmp_path, kind)[0]
    own, with_plane = still_silhouettes(rays), still_silhouettes(rays, PLANE)
    if kind == "printed":
        assert overlap(with_plane, rays) > 0.85
    else:
        assert all(torch.equal(one, other) for one, other in zip(own, with_plane, strict=True))


def test_a_plain_plate_is_left_alone(plain):
    for own, with_plane in zip(still_silhouettes(plain), still_silhouettes(plain, PLANE), strict=True):
        torch.testing.assert_close(own, with_plane, rtol=0, atol=0)


def test_a_wrong_plane_is_no_print(printed):
    above = Support(PLANE.normal, HEIGHT + 0.3)
    for own, with_plane in zip(still_silhouettes(printed), still_silhouettes(printed, above), strict=True):
        torch.testing.assert_close(own, with_plane, rtol=0, atol=0)


@pytest.mark.parametrize("shape", [None, BALL_SDF], ids=["nothing known", "the ball known"])
def test_known_colors_are_those_of_the_print(printed, shape):
    texture = plate_print(SmallPhotos(printed), PLANE, shape)
    axis = (np.arange(len(texture.known)) + 0.5) / len(texture.known) * 2 - 1
    points = PLANE.square(texture.half_side * axis)
    known, away = texture.known.numpy(), np.hypot(points[..., 0], points[..., 1])
    assert known[(away < PLATE - 0.05) & (np.linalg.norm(points - PLACE, axis=-1) > 0.7)].mean() > 0.9
    true = tone_map(torch.from_numpy(pattern(points.reshape(-1, 3)))).view(points.shape).numpy()
    wrong = np.abs(tone_map(texture.color).numpy() - true).mean(-1)[known & (away < PLATE - 0.05)]
    assert np.median(wrong) < 0.01 and (wrong > 0.06).mean() < 0.05
