"""Scene points that photos show behind free space carve a hull."""

import numpy as np

from blender_nep.cameras.seen_through import seen_through, without_free_space

CENTER, RADIUS, BALL = np.array([5.0, -2.0, 1.0]), 4.0, 0.5
CELLS = (np.arange(32) + 0.5) / 16 - 1
GRID = np.stack(np.meshgrid(CELLS, CELLS, CELLS, indexing="ij"), -1)
AWAY = np.linalg.norm(GRID, axis=-1)


def lines(photos=24, length=6.0):
    """What cameras 3 radii away see of points `length` radii before them, past a ball in the middle. World frame."""
    random, out = np.random.default_rng(0), []
    for _ in range(photos):
        camera = random.normal(size=3)
        camera *= 3 / np.linalg.norm(camera)
        direction = random.uniform(-1, 1, (800, 3)) - camera
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        past = np.linalg.norm(camera - (direction @ camera)[:, None] * direction, axis=1) > BALL
        out.append((CENTER + RADIUS * camera, CENTER + RADIUS * (camera + length * direction[past])))
    return out


def test_cells_beside_the_ball_are_free_and_those_in_it_are_not():
    free = seen_through(lines(), CENTER, RADIUS)
    cell = np.sqrt(3) / 32
    assert not free[AWAY < BALL - cell].any()
    assert free[(AWAY > BALL + cell) & (AWAY < 1)].mean() > 0.95


def test_one_photo_and_points_before_the_sphere_free_nothing():
    assert not seen_through(lines(photos=1), CENTER, RADIUS).any()
    assert not seen_through(lines(length=2.0), CENTER, RADIUS).any(), "the points lie before the sphere"
    assert not seen_through([], CENTER, RADIUS).any()


def test_a_hull_loses_what_photos_look_through():
    fine = (np.arange(64) + 0.5) / 32 - 1
    x, y, z = np.meshgrid(fine, fine, fine, indexing="ij")
    ball = np.sqrt(x**2 + y**2 + z**2) - BALL
    column = np.maximum(np.hypot(x, y) - 0.2, z)  # from the ball down to the end of the sphere
    carved = without_free_space(np.minimum(ball, column).astype(np.float32), seen_through(lines(), CENTER, RADIUS))
    assert (carved[ball < -0.05] < 0).all(), "the ball stays"
    assert (carved[ball > 0.15] > 0).all(), "the column goes"


def test_a_hull_that_is_free_everywhere_stays():
    hull = (AWAY - BALL).astype(np.float32)
    assert np.array_equal(without_free_space(hull, np.ones((32, 32, 32), bool)), hull)
