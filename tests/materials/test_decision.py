"""What all evidence says is joined in one place, and evidence that is switched off is not asked."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch

from blender_nep.materials.evidence import decision
from blender_nep.materials.evidence.decision import (
    ALL,
    Account,
    decide_metallic,
    decide_roughness,
    decide_segments,
    shift_of_dielectrics,
)
from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfMetallic, OfRoughness
from blender_nep.materials.evidence.residual import SegmentResidual
from blender_nep.materials.fitting import roughness_at, roughness_scan
from blender_nep.messages import Message
from blender_nep.presets import EVIDENCE, MaterialPreset
from support.lit_ball import PRESET, constant, learn, make_photos

ROW = torch.arange(len(roughness_scan(MaterialPreset().least_roughness, torch.device("cpu"))))
METAL, PAINT, RED = 0, 1, 2
"""The three materials of `materials`: the third moment says something of the red paint alone"""


def materials(*without: str) -> FittedMaterials:
    """A metal, and two paints, with hardly any samples: what the evidence says is made up."""
    nothing = torch.zeros(3)
    metallic, label = torch.tensor([1.0, 0.0, 0.0]), torch.arange(3)
    preset = replace(MaterialPreset(), without=without, spread_margin=0.0301)
    cost = torch.ones(2, len(ROW), 3)
    return FittedMaterials(None, nothing, np.zeros((3, 3)), np.zeros(3), label, nothing, metallic, cost, preset, label)


@dataclass
class Saying(Evidence):
    """Evidence that says what it is told to say."""

    name: str
    metallic: OfMetallic | None = None
    roughness: dict[int, OfRoughness] = field(default_factory=dict)
    why_not: Message | None = None

    def skipped(self, fitted):
        return self.why_not

    def of_metallic(self, fitted):
        return self.metallic

    def of_roughness(self, fitted):
        return self.roughness


def bowl(row: float) -> torch.Tensor:
    """A residual that is least at a row, and 3 % higher three rows away."""
    return 0.05 * (1 + 0.03 * ((ROW - row) / 3) ** 2)


def vanishing_at(row: float):
    return lambda r: 0.1 * (row - r)


@pytest.fixture
def saying(monkeypatch):
    """Four say something of the roughness of the materials."""
    said = (
        Saying(
            "residual", roughness={METAL: OfRoughness(bowl(5)), PAINT: OfRoughness(bowl(10)), RED: OfRoughness(bowl(20))}
        ),
        Saying("spread", roughness={METAL: OfRoughness(log_ratio=vanishing_at(4.25))}),
        Saying("hue"),
        Saying("third_moment", roughness={RED: OfRoughness(bowl(15) / 0.05, vanishing_at(14.5))}),
    )
    monkeypatch.setattr(decision, "ALL", said)


def test_all_evidence_has_a_name_that_the_preset_knows():
    assert tuple(evidence.name for evidence in ALL) == EVIDENCE
    assert replace(MaterialPreset(), without=EVIDENCE).without == EVIDENCE
    with pytest.raises(ValueError, match="no evidence named color: choose among residual, spread"):
        replace(MaterialPreset(), without=("hue", "color"))


@pytest.mark.parametrize(
    ("without", "expected"),
    [
        ((), {METAL: 4.25, PAINT: 10.0, RED: 14.5}),  # of the red paint the third moment decides
        (("spread",), {METAL: 5.0, PAINT: 10.0, RED: 14.5}),  # the least residual
        (("third_moment",), {METAL: 4.25, PAINT: 10.0, RED: 20.0}),
        (("residual",), {METAL: 4.25, RED: 14.5}),  # the spread alone; nothing says anything of the other paint
        (("residual", "spread", "third_moment"), {}),
        (("hue",), {METAL: 4.25, PAINT: 10.0, RED: 14.5}),
    ],
)
def test_roughness_is_decided_by_all_evidence_that_counts(saying, without, expected):
    fitted = materials(*without)
    place, known, account = decide_roughness(fitted)
    assert {k: place[k].item() for k in range(3) if known[k]} == pytest.approx(expected, abs=0.01)
    told = {name for said in account.told for name in said}
    assert told == {"residual", "spread", "third_moment"} - set(without)
    report = account.report()
    assert all(report[name]["skipped"]["code"] == "reason.preset" for name in without)
    if "third_moment" in told:
        roughness = float(roughness_at(torch.tensor(expected[RED]), fitted.preset.least_roughness))
        assert report["third_moment"] == {"acted": [{"material": RED, "roughness": pytest.approx(roughness, abs=1e-3)}]}


def test_the_spread_counts_only_within_the_range_of_the_residual(monkeypatch):
    beyond = Saying("spread", roughness={METAL: OfRoughness(log_ratio=vanishing_at(20.0))})
    residual = Saying("residual", roughness={METAL: OfRoughness(bowl(5))})
    monkeypatch.setattr(decision, "ALL", (residual, beyond, Saying("hue"), Saying("third_moment")))
    assert decide_roughness(materials())[0][METAL] == 8
    assert decide_roughness(materials("residual"))[0][METAL] == 20


@pytest.mark.parametrize(
    ("without", "expected"),
    [
        ((), [1, 0, 0]),  # the hue makes the first a metal, against the residual; it says nothing of the others
        (("hue",), [0, 0, 0]),
        (("residual",), [1, 1, 1]),  # then the prior decides, which favors metal a little
        (("residual", "hue"), [1, 1, 1]),
    ],
)
def test_the_class_has_the_least_product_of_all_costs(monkeypatch, without, expected):
    residual = OfMetallic(torch.tensor([[1.0, 1.0, 1.0], [1.1, 1.1, 2.0]]), {k: {"other_class": 0.1} for k in range(3)})
    hue = OfMetallic(torch.tensor([[1.0, 1.0, 1.0], [0.85, 1.0, 1.0]]), {0: {"metal": 1.0}})
    said = (Saying("residual", residual), Saying("spread"), Saying("hue", hue), Saying("third_moment"))
    monkeypatch.setattr(decision, "ALL", said)
    assert materials().preset.metal_margin == -0.03
    chosen, account = decide_metallic(materials(*without))
    assert chosen.tolist() == expected
    assert {name for told in account.told for name in told} == {"residual", "hue"} - set(without)
    assert decide_metallic(materials(), without=("hue",))[0].tolist() == [0, 0, 0], "as long as the hue is not asked"
    dark = torch.tensor([[1.0, 1.0, 1.0], [1.3, 1.0, 1.0]])  # the first is too dark for a metal
    assert decide_metallic(materials(*without), prior=dark)[0].tolist() == [0, *expected[1:]]


def test_the_account_says_why_evidence_did_not_act():
    classes = Account(({"hue": {"metal": 1.0}}, {}, {"hue": {"metal": -0.5}}), {})
    roughness = Account(({"spread": {"roughness": 0.2}}, {}, {}), {"third_moment": Message("reason.all_metal")})
    report = classes.and_then(roughness).pick([2, 0]).report()
    assert report["hue"] == {"acted": [{"material": 0, "metal": -0.5}, {"material": 1, "metal": 1.0}]}
    assert report["spread"] == {"acted": [{"material": 1, "roughness": 0.2}]}
    assert report["third_moment"]["skipped"]["code"] == "reason.all_metal"
    assert report["residual"]["skipped"]["code"] == "reason.evidence_silent"


GOLD, BRICK = (0.9, 0.6, 0.3), (0.5, 0.1, 0.1)


@pytest.fixture(scope="module")
def photos():
    """Photos of a ball for each metallic value: gold, and red paint."""
    return {metallic: make_photos(constant(color, 0.2, metallic)) for color, metallic in ((GOLD, 1.0), (BRICK, 0.0))}


@pytest.mark.parametrize(
    ("metallic", "acts"), [(1.0, {"residual", "spread", "hue"}), (0.0, {"residual", "hue", "third_moment"})]
)
def test_the_report_says_which_evidence_acted(ball, photos, metallic, acts, monkeypatch):
    monkeypatch.setattr("blender_nep.materials.evidence.hue._PLACE", 0.3)  # the samples are few
    report = learn(ball, photos[metallic], PRESET).report["evidence"]
    assert tuple(report) == EVIDENCE
    assert {name for name, entry in report.items() if "acted" in entry} == acts
    assert report["regions"]["skipped"]["code"] == "reason.one_material"
    (other,) = set(EVIDENCE) - acts - {"regions"}
    assert report[other]["skipped"]["code"] == ("reason.all_metal" if metallic else "reason.no_metal")
    assert report["residual"]["acted"][0]["roughness"] == pytest.approx(0.2, abs=0.08)
    assert np.sign(report["hue"]["acted"][0]["metal"]) == 2 * metallic - 1


@pytest.mark.parametrize("off", ALL, ids=EVIDENCE)
def test_evidence_that_is_switched_off_is_not_asked(ball, photos, off, monkeypatch):
    def asked(*_):
        raise AssertionError("it was asked")

    for name in ("skipped", "of_metallic", "of_roughness"):
        monkeypatch.setattr(type(off), name, asked)
    preset = replace(PRESET, without=(off.name,))
    report = learn(ball, photos[1.0 if off.name == "spread" else 0.0], preset).report["evidence"]
    assert report[off.name]["skipped"]["code"] == "reason.preset"
    assert sum("acted" in entry for entry in report.values()) >= 1


def test_the_third_moment_moves_the_dielectrics_of_segments():
    """By the steps of the scan between both roughness values: the mean over the paints, weighted by their shares."""
    preset = MaterialPreset()
    values = roughness_scan(preset.least_roughness, torch.device("cpu")).tolist()

    def said(residual: int, moment: int | None) -> dict:
        told = {"residual": {"other_class": 0.2, "roughness": values[residual]}}
        return told if moment is None else told | {"third_moment": {"roughness": values[moment]}}

    account = Account((said(20, 15), said(9, None), said(12, 11), said(14, 3)))
    metallic = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.5])  # the last one is a blend, of which nothing is told
    roughness = torch.tensor([values[k] for k in (15, 9, 11, 3, 8)])
    shares = (0.3, 0.2, 0.1, 0.3, 0.1)
    wanted = (0.3 * (15 - 20) + 0.1 * (11 - 12)) / 0.6
    assert shift_of_dielectrics(account, roughness, metallic, shares, preset) == pytest.approx(wanted, abs=1e-3)
    unmoved = torch.tensor([values[k] for k in (20, 9, 12, 3, 8)])
    assert shift_of_dielectrics(account, unmoved, metallic, shares, preset) == pytest.approx(0, abs=1e-3), "an older account"
    assert shift_of_dielectrics(Account(), roughness, metallic, shares, preset) == 0


def test_only_dielectrics_are_moved_and_stay_in_the_scan():
    """Three segments far apart, each with a parabola of residuals: a metal, a paint, and a paint at the sharp end."""
    least, count = np.array([12, 20, 1]), len(ROW)
    cost = np.broadcast_to(0.1 + 1e-4 * (np.arange(count)[:, None] - least) ** 2, (2, count, 3)).astype(np.float32)
    index = np.tile(np.arange(3)[:, None], 64)
    residual = SegmentResidual(cost, np.ones(3), np.full(index.shape, 0.0), index)
    preset, chosen = replace(MaterialPreset(), segment_prior=0.0), np.array([1, 0, 0])
    _, place = decide_segments(residual, preset, (0.0, 1.0), chosen, shift=-5.0)
    np.testing.assert_allclose(place.numpy(), [12, 15, 0], atol=0.02)
    _, place = decide_segments(residual, preset, (0.0, 1.0), chosen)
    np.testing.assert_allclose(place.numpy(), least, atol=0.02)
