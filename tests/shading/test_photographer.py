"""Where the photographer stands, and how much light is left in a lobe."""

import math

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.photographer import Photographer, shadow, up_of
from blender_nep.shading.plenoptic import PlenopticFunction, PlenopticSettings, TerminalRadiance

UP = torch.tensor([0.0, 0.0, 1.0])
VIEW, OTHER = torch.tensor([0.6, 0.48, 0.64]), torch.tensor([-0.6, 0.48, 0.64])


def at(azimuth: float, elevation: float) -> torch.Tensor:
    a, e = math.radians(azimuth), math.radians(elevation)
    return torch.tensor([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def test_it_is_darkest_below_the_camera_and_bright_on_the_other_side():
    view = at(70, 40)
    below, beside, behind = (float(shadow(at(azimuth, -15), view, UP)) for azimuth in (70, 160, 250))
    assert 0.8 < below < 1.6 and beside < 0.2 * below and behind < 0.05 * below
    around = torch.stack([at(a, e) for a in range(0, 360, 5) for e in range(-90, 91, 5)])
    darkest = around[shadow(around, view.expand_as(around), UP).argmax()]
    assert float(darkest @ at(70, 0)) > 0.9


def test_it_turns_with_the_camera():
    turned = [float(shadow(at(20 + a, 10), at(50 + a, 35), UP)) for a in (0, 90, 200)]
    assert turned == pytest.approx([turned[0]] * 3, rel=1e-4)


def test_a_camera_straight_above_sees_nobody_at_its_side():
    around = torch.stack([at(a, 0) for a in range(0, 360, 30)])
    dark = shadow(around, UP.expand_as(around), UP)
    assert float(dark.max()) < 0.01 and float(shadow(UP, UP, UP)) == pytest.approx(0.3)


def test_the_share_that_is_left():
    direction, view = at(10, 5), at(0, 30)
    assert float(Photographer(0.0, UP).left(direction, view)) == 1
    once, twice = (float(Photographer(strength, UP).left(direction, view)) for strength in (1.0, 2.0))
    assert 0 < twice < once < 1 and twice == pytest.approx(once**2, rel=1e-5)


def test_cameras_tell_what_is_up():
    """Also if all of them stand on one side and look down."""
    turned = [at(azimuth, 0) for azimuth in (10, 30, 50, 70)]
    right = torch.stack([torch.linalg.cross(UP, aside) for aside in turned])
    back = torch.nn.functional.normalize(torch.stack(turned) + UP, dim=-1)
    rotations = torch.stack([right, torch.linalg.cross(back, right), back], -1)
    torch.testing.assert_close(up_of(rotations), UP, atol=1e-5, rtol=0)


class World:
    """A far sky that the photos show everywhere, of the radiance light(directions [n, 3]) -> [n]."""

    def __init__(self, light):
        self.light = light

    def query_cone(self, origins, directions, half_angle):
        return self.light(directions)[:, None].expand(-1, 3), torch.ones(len(directions))


@pytest.fixture(scope="module")
def gathered():
    """gathered(light, up) is that of 500 points of a ball, all of which are seen from one direction, `VIEW`."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.asarray(ball.vertices, np.float32), np.asarray(ball.faces)
    tracer = RayTracer(vertices, faces)
    shown = np.flatnonzero((tracer.face_normals @ torch.stack([VIEW, OTHER], 1).numpy() > 0.2).all(1))
    face = np.random.default_rng(0).choice(shown, 500)
    settings = PlenopticSettings(levels=0, diffuse=8, specular=4)

    def of(light, up=None, view=VIEW):
        f_p = PlenopticFunction(tracer, vertices, World(light), TerminalRadiance(), settings, "cpu")
        points = f_p.points(face, np.full((500, 3), 1 / 3, np.float32), view.expand(500, 3))
        generator = torch.Generator().manual_seed(3)
        return IncomingLight.gathered(f_p, points, (0.1, 0.4, 1.0), 32, torch.zeros(500), generator, lambda _: None, up)

    return of


def bright(directions):
    return torch.ones(len(directions))


def darker(strength, view):
    return lambda d: torch.exp(-strength * shadow(d, view.expand_as(d), UP))


@pytest.mark.parametrize(("strength", "error"), [(0.4, 0.02), (1.5, 0.004), (2.6, 0.01)])
def test_light_behind_a_photographer_is_that_of_a_darker_world(gathered, strength, error):
    """At 1.5 it is known. Between the strengths that are known, it is interpolated."""
    lit, dark = gathered(bright, UP), gathered(darker(strength, VIEW))
    behind = lit.behind(strength)
    torch.testing.assert_close(behind.specular[..., 0, :], dark.specular[..., 0, :], rtol=error, atol=1e-4)
    assert float((behind.diffuse / dark.diffuse - 1).abs().mean()) < 0.01
    in_steps = lit.behind(0.3).behind(strength - 0.3)
    torch.testing.assert_close(in_steps.specular, behind.specular)
    assert in_steps.photographer == pytest.approx(strength)
    torch.testing.assert_close(behind.behind(-strength).specular, lit.specular, rtol=1e-4, atol=1e-5)
    some = torch.tensor([3, 17, 240])
    torch.testing.assert_close(lit.moments_behind(strength, some).specular, behind.specular[some])
    again = behind.updated(None, torch.Generator())
    torch.testing.assert_close(again.specular, behind.specular)
    torch.testing.assert_close(again.diffuse, behind.diffuse)


def test_each_photo_has_its_own_photographer(gathered):
    first = torch.arange(500) % 2 == 0
    both = gathered(bright, UP, torch.where(first[:, None], VIEW, OTHER)).behind(2.25)
    for view, rows in ((VIEW, first), (OTHER, ~first)):
        dark = gathered(darker(2.25, view), view=view)
        torch.testing.assert_close(both.specular[rows][..., 0, :], dark.specular[rows][..., 0, :], rtol=0.01, atol=1e-3)


def test_nobody_takes_light_where_up_is_unknown(gathered):
    lit = gathered(bright)
    assert torch.equal(lit.behind(2.0).specular, lit.specular) and not lit.traced.shadow.any()
