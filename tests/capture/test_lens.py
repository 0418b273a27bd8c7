"""Lens distortion: against OpenCV's formulas, closed forms, and areas that are measured by brute force."""

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens, Lenses
from blender_nep.capture.doctor.summary import summarize

REAL = Lens(k1=-0.12, k2=0.03)
ALL_TERMS = Lens(k1=-0.2, k2=0.07, k3=0.01, k4=-0.002, p1=0.004, p2=-0.006)
FISHEYE = Lens(k1=0.04, k2=-0.012, k3=0.003, k4=-0.0004, fisheye=True)
FOLDING = Lens(k1=-0.4)
"""r (1 - 0.4 r^2) grows up to r = sqrt(1 / 1.2) = 0.913, where it is 0.609."""


def opencv(lens: Lens, x, y):
    """The distorted places of x / z and y / z, as OpenCV's documentation of `projectPoints` writes it (with k4 for r^8)."""
    r2 = x**2 + y**2
    radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3 + lens.k4 * r2**4
    u = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x**2)
    return u, y * radial + lens.p1 * (r2 + 2 * y**2) + 2 * lens.p2 * x * y


def opencv_fisheye(lens: Lens, x, y):
    """The same for a fisheye lens, as OpenCV's documentation of the module `fisheye` writes it."""
    r = np.hypot(x, y)
    theta = np.arctan(r)
    distorted = theta * (1 + lens.k1 * theta**2 + lens.k2 * theta**4 + lens.k3 * theta**6 + lens.k4 * theta**8)
    return distorted / r * x, distorted / r * y


@pytest.fixture
def flat():
    """x / z and y / z of 500 directions, up to 39 degrees from the axis"""
    return np.random.default_rng(0).uniform(-0.57, 0.57, (2, 500))


@pytest.mark.parametrize(("lens", "formula"), [(REAL, opencv), (ALL_TERMS, opencv), (FISHEYE, opencv_fisheye)])
def test_places_and_directions_follow_opencv(lens, formula, flat):
    x, y = flat
    u, v = formula(lens, x, y)
    batch = Lenses.of([lens])
    directions = torch.from_numpy(np.stack([x, y, np.ones_like(x)], 1))
    found_u, found_v, shown = batch.places(3 * directions)
    np.testing.assert_allclose(np.stack([found_u, found_v]), np.stack([u, v]), atol=1e-12)
    back, _, seen = batch.directions(torch.from_numpy(u), torch.from_numpy(v))
    np.testing.assert_allclose(back, torch.nn.functional.normalize(directions, dim=1), atol=1e-9)
    assert shown.all() and seen.all()


@pytest.mark.parametrize("lens", [REAL, ALL_TERMS, FISHEYE])
def test_the_solid_angle_of_an_area_is_that_of_its_corners(lens):
    """A small square around each place, and the two flat triangles that its four directions span."""
    place, half = torch.from_numpy(np.random.default_rng(1).uniform(-0.5, 0.5, (2, 200))), 1e-4
    batch = Lenses.of([lens])
    corners = [
        batch.directions(place[0] + a * half, place[1] + b * half)[0] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    sides = [corner - corners[0] for corner in corners[1:]]
    area = 0.5 * sum(torch.linalg.cross(a, b).norm(dim=1) for a, b in ((sides[0], sides[1]), (sides[1], sides[2])))
    np.testing.assert_allclose(batch.directions(*place)[1], area / (2 * half) ** 2, rtol=1e-5)


def test_an_equidistant_fisheye_has_the_closed_form():
    """theta = r: the densities inside the radius 2 add up to the cap of 2 radians, which reaches behind the camera."""
    n = 1201
    axis = (torch.arange(n, dtype=torch.float64) + 0.5) / n * 4 - 2
    v, u = torch.meshgrid(axis, axis, indexing="ij")
    inside = torch.hypot(u, v) < 2
    _, density, shown = Lenses.of([Lens(fisheye=True)]).directions(u[inside], v[inside])
    assert shown.all()
    assert float(density.sum()) * (4 / n) ** 2 == pytest.approx(2 * np.pi * (1 - np.cos(2)), rel=1e-3)


def test_beyond_its_fold_a_lens_shows_nothing():
    batch = Lenses.of([FOLDING])
    radius = torch.linspace(0.01, 1.5, 150, dtype=torch.float64)
    zero = torch.zeros_like(radius)
    _, _, seen = batch.directions(radius, zero)
    np.testing.assert_array_equal(seen, radius < 0.6086)
    _, _, shown = batch.places(torch.stack([radius, zero, torch.ones_like(radius)], 1))
    np.testing.assert_array_equal(shown, radius < np.sqrt(1 / 1.2))
    assert not batch.places(torch.tensor([[0.1, 0.1, -1.0]], dtype=torch.float64))[2].any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "lens",
    [
        Lens(k1=-0.01227, k2=0.018288, k3=0.035678, k4=-0.013747, fisheye=True),
        Lens(k1=0.0186, k2=0.03327, k3=0.01256, k4=-0.01058, fisheye=True),
        Lens(k1=0.41406, k2=-0.010392, k3=0.015919, k4=-0.021005, p1=-0.000377, p2=0.00134),
        Lens(k1=0.1513, k2=0.21989, k3=-0.08437, k4=-0.01826, p1=0.000962, p2=-0.000604),
    ],
)
def test_no_place_inside_the_fold_is_lost(lens, dtype):
    """These lenses turn steeply just before they fold, and Newton's method alone goes in circles there."""
    batch = Lenses.of([lens], dtype=dtype)
    away = torch.linspace(0, 0.97 * float(batch.reach), 300, dtype=dtype)
    turn = torch.linspace(0, 40, 300, dtype=dtype)
    along, depth = (away.sin(), away.cos()) if lens.fisheye else (away, torch.ones_like(away))
    directions = torch.nn.functional.normalize(torch.stack([along * turn.cos(), along * turn.sin(), depth], 1), dim=1)
    u, v, shown = batch.places(directions)
    back, _, seen = batch.directions(u, v)
    assert shown.all() and seen.all()
    np.testing.assert_allclose(back, directions, atol=1e-3 if dtype == torch.float32 else 1e-7)


def test_a_fisheye_lens_holds_for_many_places_in_float32(flat):
    u, v = map(torch.from_numpy, 0.8 * flat)
    exact = Lenses.of([FISHEYE]).directions(u, v)
    found = Lenses.of([FISHEYE, FISHEYE], dtype=torch.float32).at(1).directions(u.float(), v.float())
    for one, other in zip(exact, found, strict=True):
        np.testing.assert_allclose(other, one, rtol=3e-6, atol=1e-6)


def test_each_row_of_a_batch_has_its_own_lens(flat):
    u, v = map(torch.from_numpy, 0.8 * flat)
    lenses = [REAL, FISHEYE, Lens(), ALL_TERMS]
    which = torch.arange(len(u)) % 4
    together = Lenses.of(lenses).at(which).directions(u, v)
    for k, lens in enumerate(lenses):
        alone = Lenses.of([lens]).directions(u[which == k], v[which == k])
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_allclose(all_of_them[which == k], one, atol=1e-12)


def distorted_camera(lens: Lens = ALL_TERMS) -> Camera:
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.sign(np.linalg.det(turn))
    matrix[:3, 3] = 1, -2, 0.5
    return Camera(60, 40, 55.0, 56.0, 31.0, 19.0, matrix, lens)


@pytest.mark.parametrize("lens", [ALL_TERMS, FISHEYE])
def test_a_camera_projects_back_and_keeps_its_lens_when_scaled(lens):
    camera = distorted_camera(lens)
    x, y = np.random.default_rng(0).uniform(0, 1, (2, 50)) * [[60], [40]]
    points = camera.position + 3 * camera.directions(x, y)
    px, py, depth = camera.project(points)
    np.testing.assert_allclose(np.stack([px, py]), np.stack([x, y]), atol=1e-7)
    assert (depth > 0).all() and camera.shown_pixels(30, 20).all()
    small = camera.scaled(30, 20)
    np.testing.assert_allclose(small.directions(x / 2, y / 2), camera.directions(x, y), atol=1e-12)


@pytest.mark.parametrize(
    "lens", [REAL, ALL_TERMS, FISHEYE, FOLDING, Lens(k1=-0.7, k2=0.1, p1=0.01), Lens(k1=-0.6, fisheye=True)]
)
@pytest.mark.parametrize("focal", [30.0, 55.0])
@pytest.mark.parametrize("center", [(31.0, 19.0), (-5.0, 60.0)])
def test_the_shown_pixels_are_those_that_every_pixel_says(lens, focal, center):
    camera = Camera(60, 40, focal, focal, *center, np.eye(4), lens)
    y, x = np.indices((40, 60)).reshape(2, -1) + 0.5
    u, v = torch.from_numpy((x - center[0]) / focal), torch.from_numpy((y - center[1]) / focal)
    np.testing.assert_array_equal(camera.shown_pixels(60, 40), Lenses.of([lens]).directions(u, v)[2])


def test_a_lens_that_shows_the_border_is_asked_for_no_other(monkeypatch):
    asked, directions = [], Lenses.directions

    def counted(lenses, u, v):
        asked.append(len(u))
        return directions(lenses, u, v)

    monkeypatch.setattr(Lenses, "directions", counted)
    camera = Camera(300, 200, 280.0, 281.0, 151.0, 99.0, np.eye(4), REAL)
    assert camera.shown_pixels(300, 200).all() and camera.shown_pixels(300, 200).shape == (300 * 200,)
    assert asked == [2 * (300 + 200)]


def test_the_sides_of_the_image_have_distance_zero():
    """The direction through the middle of each side lies in that side's plane, and the image's center inside all."""
    camera = distorted_camera()
    x, y = np.array([0, 60, 31.0, 31.0]), np.array([19.0, 19.0, 0, 40])
    on_sides = camera.position + 2 * camera.directions(x, y)
    np.testing.assert_allclose([camera.side_distances(p)[k] for k, p in enumerate(on_sides)], 0, atol=1e-9)
    assert (camera.side_distances(camera.position + camera.optical_axis) > 0).all()


def with_lens(tiny, **keys):
    tiny.meta |= keys
    tiny.save()
    return load_capture(tiny.folder)


def test_pixel_rays_and_projections_bend_with_the_lens(make_capture):
    """In every frame, the rays of downscaled photos are the camera's own, and points on them project back."""
    capture = with_lens(make_capture(views=4, size=24), camera_model="OPENCV", k1=-0.12, k2=0.03, p1=0.002)
    assert capture.views[0].camera.lens == Lens(k1=-0.12, k2=0.03, p1=0.002)
    rays = PixelRays.from_capture(capture, 12 * 12, use_masks=False)
    for view in range(4):
        index = torch.arange(rays.offset[view], rays.offset[view + 1])
        origin, direction, half = rays.rays(index)
        y, x = np.mgrid[:12, :12] * 2 + 1.0
        np.testing.assert_allclose(direction, capture.views[view].camera.directions(x.ravel(), y.ravel()), atol=2e-6)
        place, ahead = rays.project(view, origin + 2.5 * direction)
        np.testing.assert_allclose(place, np.stack([x.ravel(), y.ravel()], 1) / 12 - 1, atol=1e-5)
        assert ahead.all() and (half > 0).all()


def test_the_field_of_view_is_that_of_the_lens(make_capture):
    """An equidistant fisheye sees the same angle per pixel everywhere; without distortion, an angle has its tangent."""
    wide = Camera(640, 480, 160.0, 160.0, 300.0, 250.0, np.eye(4), Lens(fisheye=True))
    assert wide.field_of_view == pytest.approx(640 / 160)
    flat = Camera(640, 480, 160.0, 160.0, 300.0, 250.0, np.eye(4))
    assert flat.field_of_view == pytest.approx(np.arctan(300 / 160) + np.arctan(340 / 160))
    bent = Camera(640, 480, 400.0, 400.0, 320.0, 240.0, np.eye(4), REAL)
    edge = 2 * bent.directions(np.array([0.0]), np.array([240.0]))[0]
    assert bent.field_of_view == pytest.approx(2 * np.arctan(edge[0] / edge[2]), rel=1e-9)
    capture = with_lens(make_capture(views=4), camera_model="OPENCV_FISHEYE")
    assert summarize(capture.folder)["field_of_view_deg"] == [round(float(np.degrees(24 / 28.8)), 2)] * 2


def test_distortion_of_one_frame_overrides_the_top(make_capture):
    tiny = make_capture(views=4)
    tiny.meta["frames"][1]["k1"] = 0.05
    capture = with_lens(tiny, k1=-0.1)
    assert [view.camera.lens.k1 for view in capture.views] == [-0.1, 0.05, -0.1, -0.1]


def test_instant_ngps_fisheye_counts_without_a_camera_model(make_capture):
    tiny = make_capture(views=4)
    tiny.meta["frames"][1]["is_fisheye"] = False
    tiny.meta["frames"][2]["camera_model"] = "OPENCV"
    lenses = [view.camera.lens for view in with_lens(tiny, is_fisheye=True, k1=0.02).views]
    fisheye, flat = Lens(k1=0.02, fisheye=True), Lens(k1=0.02)
    assert lenses == [fisheye, flat, flat, fisheye]
    assert not with_lens(tiny, is_fisheye=False).views[0].camera.lens.fisheye


def test_a_capture_without_distortion_takes_the_short_way(make_capture):
    rays = PixelRays.from_capture(with_lens(make_capture(views=4), camera_model="OPENCV", k1=0.0), 10**6, use_masks=False)
    assert rays._lenses is None


def test_pixels_that_a_folding_lens_cannot_show_are_left_out(make_capture):
    capture = with_lens(make_capture(views=4, size=24), k1=-3.0)
    rays = PixelRays.from_capture(capture, 10**6, use_masks=False)
    y, x = np.indices((24, 24)) + 0.5
    radius = np.hypot(x - 12, y - 12) / (1.2 * 24)
    fold = np.sqrt(1 / 9)
    reached = radius < fold * (1 - 3 * fold**2)
    assert 0 < reached.sum() < reached.size
    np.testing.assert_array_equal(rays.valid[: 24 * 24].reshape(24, 24), reached)
