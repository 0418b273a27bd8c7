"""Residuals of materials, and when a material of the palette is dropped."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from blender_nep.materials.palette.palette import Palette, error
from blender_nep.materials.palette.search import FoundPalette, PaletteSearch
from blender_nep.presets import MaterialPreset
from blender_nep.shading.light_moments import LightMoments

PRESET = MaterialPreset()


def dropped(materials, raised):
    """How many of `materials` are left, if every material less raises the left-out residual by the share `raised`."""

    def left_out(palette):
        return (1 + raised) ** (materials - (len(palette) - palette.blends))

    one = torch.linspace(0.1, 0.9, materials)
    search = SimpleNamespace(
        preset=PRESET,
        assigned=lambda _, palette: FoundPalette(palette, torch.arange(len(palette))),  # equal shares
        _left_out=left_out,
        without_superfluous=lambda found: PaletteSearch.without_superfluous(search, found),
    )
    palette = Palette(one[:, None].expand(-1, 3), one, one)
    return len(search.without_superfluous(FoundPalette(palette, torch.arange(materials))).palette)


@pytest.mark.parametrize(
    ("materials", "raised", "left"),
    [
        (2, 0.08, 2),  # one material has no blends: it must explain all by itself
        (2, 0.04, 1),
        (3, 0.08, 2),  # blends of the other two can stand in the third one's place
        (3, 0.15, 3),
        (5, 0.08, 2),
    ],
)
def test_a_material_that_blends_can_replace_must_explain_more(materials, raised, left):
    assert PRESET.gain == 0.05 and 0.08 < PRESET.blended_gain < 0.15
    assert dropped(materials, raised) == left


def test_the_residual_of_one_material_is_that_at_each_sample():
    generator, n = torch.Generator().manual_seed(0), 60
    levels = torch.tensor([0.03, 0.2, 0.5, 1.0])
    light = LightMoments(
        torch.rand(n, 4, 3, 3, generator=generator),
        torch.rand(n, 3, generator=generator),
        torch.ones(n, 4),
        torch.rand(n, generator=generator),
        levels,
    )
    target, weight = torch.rand(n, 3, generator=generator), torch.rand(n, generator=generator)
    for metallic, roughness in ((0.0, 0.03), (1.0, 0.31), (0.4, 1.0)):
        palette = Palette(torch.tensor([[0.7, 0.4, 0.1]]), torch.tensor([roughness]), torch.tensor([metallic]))
        one, each = (palette.at(torch.zeros(count, dtype=torch.int64)) for count in (1, n))
        residual = error(light, target, weight, one, 0.2)
        torch.testing.assert_close(residual, error(light, target, weight, each, 0.2))
        assert residual.shape == (n,) and 0 < residual.max() <= 0.2


def test_fits_leave_out_doubtful_samples_but_no_whole_material():
    palette = Palette(torch.rand(3, 3), torch.rand(3), torch.tensor([1.0, 0.0, 0.0]))
    label = torch.tensor([0] * 20 + [1] * 20 + [2] * 20)
    found = FoundPalette(palette, label)
    assert torch.equal(found.label_of_fits, label)
    doubtful = (torch.arange(60) % 4 == 0) & (label == 0) | (label == 1) | (torch.arange(60) < 1)
    left = replace(found, doubtful=doubtful).label_of_fits
    assert (left[:20] == -1).sum() == 5 and (left[20:40] == 1).all() and (left[40:] == 2).all()
