"""On a turntable the room stands still: it tells exposures, and cannot tell vignetting."""

from dataclasses import replace

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.exposure.surroundings import compare_exposures
from blender_nep.capture.rays.rigid_motions import RigidMotions
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    """Photos of a still room whose corners are dark, by a still camera. The object's frame turns from photo to photo."""
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 40_000, False)
    origin, rotation = rays.cameras()
    index = torch.arange(rays.count)
    square = rays.from_middle(index)
    within = index - torch.as_tensor(rays.offset)[rays.view_of(index)]
    x, y = (within % rays.size[0][1]).float() / 20, square.sqrt() * 30
    room = (0.4 + 0.2 * x.sin() + 0.1 * y.cos()) * (-square).exp()
    still = replace(rays, radiance=room[:, None] * torch.tensor([1.0, 0.8, 0.6]))
    return still.with_turntable(RigidMotions.of_still_camera(rotation, origin))


def times(rays, factor):
    """The same photos, each pixel of whose radiance is multiplied by factor [n] or [n, 3]."""
    return replace(rays, radiance=rays.radiance * factor)


def test_exposures_are_found(rays):
    gain = torch.exp(0.3 * torch.randn(rays.views, 1, generator=torch.Generator().manual_seed(0)))
    taken = times(rays, gain[rays.view_of(torch.arange(rays.count))])
    found = compare_exposures(taken).exposures()
    assert found.gain is not None and found.warning is None
    torch.testing.assert_close(found.gain, (gain / gain.log().mean().exp()).expand(-1, 3), rtol=0.02, atol=0)


def test_a_still_room_tells_no_vignetting(rays):
    """A room that is dark around the middle of the photos is no lens. A job divided a museum's photos by such a ring."""
    compared = compare_exposures(rays)
    assert compared.falloff == pytest.approx([0, 0]) and compared.vignetting is None
    assert compared.exposures().gain is None


def test_gains_must_explain_a_still_room_well(rays):
    """After a walk, surroundings are compared across spheres that they are not, so less can be asked."""
    slow = torch.linspace(0.3, -0.3, rays.views).exp()[rays.view_of(torch.arange(rays.count))]
    compared = compare_exposures(times(rays, slow[:, None]))
    assert compared.exposures().gain is not None
    badly = replace(compared, left=0.8)
    assert badly.exposures().gain is None and replace(badly, on_turntable=False).exposures().gain is not None
