"""Small regions that predict held-out photos tell metal from dielectric, where an object has both."""

import numpy as np
import pytest
import torch

from blender_nep.materials.evidence import regions
from blender_nep.materials.evidence.regions import class_by_regions
from blender_nep.presets import MaterialPreset
from support.lit_ball import learn, make_photos

PHOTOS, EACH = 12, 40
GOLD, BRICK = torch.tensor([0.9, 0.6, 0.3]), torch.tensor([0.5, 0.1, 0.1])


def half_gold(points):
    gold = points[:, 2] > 0
    return torch.where(gold[:, None], GOLD, BRICK), torch.where(gold, 0.25, 0.2), gold.float()


def test_the_halves_of_a_ball_are_told(ball):
    report = learn(ball, make_photos(half_gold, views=16)).report
    said = {entry["material"]: entry["metal"] for entry in report["evidence"]["regions"]["acted"]}
    assert said == {k: 2 * material["metallic"] - 1 for k, material in enumerate(report["materials"])}
    assert sorted(said.values()) == [-1, 1]


@pytest.fixture
def said(monkeypatch):
    """said(log ratios, noise): what is said of materials whose held-out errors as dielectrics and as metals differ so much.

    noise is the deviation of the log ratio between photos.
    """

    def of(ratios, noise=0.0):
        n, random = PHOTOS * EACH, torch.Generator().manual_seed(0)
        photo = torch.arange(n) % PHOTOS
        group = torch.arange(len(ratios)).repeat_interleave(n)
        of_photo = noise * torch.randn(len(ratios), PHOTOS, generator=random)
        ratio = torch.cat([ratio + own[photo] for ratio, own in zip(ratios, of_photo, strict=True)]).double()
        errors = (0.05 * ratio.exp(), torch.full_like(ratio, 0.05))
        errors[0][::7] = torch.nan  # no other photo shows these regions
        monkeypatch.setattr(regions, "_held_out_errors", lambda *_: errors)
        photos, target = photo.repeat(len(ratios)), torch.zeros(len(group), 3)
        found = class_by_regions(None, target, np.zeros((len(group), 3)), photos, group, len(ratios), MaterialPreset())
        return found.tolist()

    return of


def test_both_classes_must_be_clear(said):
    assert said([0.25, -0.2, 0.05]) == [1, -1, 0]
    assert said([-0.25, -0.2, -0.4]) == [0, 0, 0], "a wrong shape says dielectric everywhere"
    assert said([0.25, -0.05]) == [0, 0] == said([0.05, -0.3])


def test_what_differs_between_photos_is_not_sure(said):
    assert said([0.25, -0.25], noise=0.05) == [1, -1]
    assert said([0.25, -0.25], noise=1.5) == [0, 0]
