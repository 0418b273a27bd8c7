"""Joins what all evidence says: it decides the class (metal or dielectric) and the roughness of materials.

**The class** has the least product of all costs and of the prior (`preset.metal_margin`). The unseen light is learned with
the same prior and the same hues (`factors_of_change`). Where regions are clear, they outweigh the hue.

**The roughness of a metal.** The residual gives a range of roughness values, and within the range the spread decides. Among
lobes that are sharper than the light, which have the spread of a mirror, the residual decides. If the photos vary more than
a mirror would, the residual decides among lobes whose spreads differ by less than what is missing.

**The roughness of a dielectric.** A colored one, of which the third moment says something, has it from its own channel: the
residual of the channel gives a range, and the third moment decides. Colored paints share one unless they are far apart. For
the others the residual of their reflections decides, and those that the photos hardly tell apart share one: a bright glaze
hides its reflections in the light from below, and a dark one shows them.

**Materials that vary** have the residual of their segments. If shape or light is a little wrong, highlights are not
where they are predicted, and the residual makes paints too dull. The third moment tells so of the palette's dielectrics. It
moves those of the segments as far (`shift_of_dielectrics`).

Evidence that the preset leaves out (`preset.without`) is not asked. If nothing says anything of a material's roughness, the
material keeps that of its fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.evidence.hue import Hue
from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfRoughness
from blender_nep.materials.evidence.regions import Regions
from blender_nep.materials.evidence.residual import Residual, SegmentResidual
from blender_nep.materials.evidence.spread import Spread
from blender_nep.materials.evidence.third_moment import ThirdMoment
from blender_nep.materials.fitting import place_in_scan, place_of_least, roughness_at
from blender_nep.messages import Message

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset

ALL: tuple[Evidence, ...] = (Residual(), Spread(), Hue(), ThirdMoment(), Regions())
"""All evidence. The names are those of `presets.EVIDENCE`."""
_PLACES = 8
"""Places between two neighboring values of `roughness_scan`, so that the end of the lobes that are alike is found."""
_ALIKE_SPREADS = 0.02
"""Spreads whose logs differ by less are not told apart."""
_MOST_LOG = 1.0
"""Logs of ratios of third moments are limited to this, so that one paint does not outweigh all others in a mean."""
_APART = 0.3
"""Paints have a roughness of their own if the log of (predicted third moment / that of the photos) is farther from 0 than
this with a common one. Measured with the true roughness: -0.26 to 0.13 for four paints (`balanced`, three seeds of three of
them), and -0.48 to 0.28 for six (`preview`)."""
_ALIKE_MOMENTS = 0.05
"""Third moments whose logs differ by less are not told apart. With the true roughness they are wrong by more."""


@dataclass(frozen=True)
class Account:
    """What each evidence said when K materials were decided, and why others did not apply."""

    told: tuple[dict[str, dict[str, float]], ...] = ()
    """[K] of each material: {name of an evidence: {quantity: value}}"""
    skipped: Mapping[str, Message] = field(default_factory=dict)
    """{name of an evidence: why it does not apply}"""

    def pick(self, index: Sequence[int]) -> Account:
        """The same of some of the materials."""
        return replace(self, told=tuple(self.told[k] for k in index)) if self.told else self

    def and_then(self, later: Account) -> Account:
        """This account of the same materials, with what was said later. `later.skipped` holds."""
        before = self.told or ({},) * len(later.told)
        return Account(tuple(_merged(*both) for both in zip(before, later.told, strict=True)), later.skipped)

    def report(self) -> dict[str, dict[str, Any]]:
        """{name of an evidence: what it did} for report.json: `acted`, or the message `skipped`."""
        return {str(evidence.name): self._report_of(evidence.name) for evidence in ALL}

    def _report_of(self, name: str) -> dict[str, Any]:
        acted = [{"material": k, **told[name]} for k, told in enumerate(self.told) if name in told]
        if acted:
            return {"acted": acted}
        return {"skipped": self.skipped.get(name, Message("reason.evidence_silent")).to_dict()}


def _merged(before: dict[str, dict[str, float]], later: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    return {name: before.get(name, {}) | later.get(name, {}) for name in before | later}


def skipped(evidence: Evidence, fitted: FittedMaterials) -> Message | None:
    """Why the evidence does not count for these materials: left out by the preset, or not applicable. None if it counts."""
    return Message("reason.preset") if evidence.name in fitted.preset.without else evidence.skipped(fitted)


def decide_metallic(
    fitted: FittedMaterials, without: Sequence[str] = (), prior: Tensor | None = None
) -> tuple[Tensor, Account]:
    """The metallic value of each material, as an index [K] into those of the preset: that with the least product of costs.

    `preset.metal_margin` is one of the factors, and so is `prior` [M, K], if there is one. Evidence that is named in
    `without` is not asked.
    """
    metallic = torch.tensor(fitted.preset.metallic, device=fitted.cost.device)[:, None]
    cost = (1 + fitted.preset.metal_margin * metallic).expand(-1, len(fitted))
    cost = cost if prior is None else cost * prior
    told: list[dict[str, dict[str, float]]] = [{} for _ in range(len(fitted))]
    for evidence in ALL:
        said = None if evidence.name in without or skipped(evidence, fitted) else evidence.of_metallic(fitted)
        if said is not None:
            cost = cost * said.cost
            for k, values in said.told.items():
                told[k][evidence.name] = values
    return cost.argmin(0), Account(tuple(told), _skipped(fitted))


def _skipped(fitted: FittedMaterials) -> dict[str, Message]:
    return {evidence.name: why for evidence in ALL if (why := skipped(evidence, fitted)) is not None}


def decide_roughness(fitted: FittedMaterials) -> tuple[Tensor, Tensor, Account]:
    """The place [K] of each material's roughness in `roughness_scan`, and for which materials it is known [K] bool."""
    said = {evidence.name: {} if skipped(evidence, fitted) else evidence.of_roughness(fitted) for evidence in ALL}
    residual, spreads, moments = said[Residual.name], said[Spread.name], said[ThirdMoment.name]
    places: dict[int, float] = {}
    alone = [k for k in fitted.dielectrics if k in residual]
    places |= zip(alone, _places_of_dielectrics([residual[k] for k in alone], fitted.preset), strict=True)
    places |= zip(moments, _places_of_colored([*moments.values()], fitted.preset), strict=True)
    for k in fitted.metals:
        place = _place_of_metal(residual.get(k), spreads.get(k), fitted)
        if place is not None:
            places[k] = place
    at = torch.zeros(len(fitted), device=fitted.label.device)
    known = torch.zeros(len(fitted), dtype=torch.bool, device=at.device)
    for k, place in places.items():
        at[k], known[k] = place, True
    return at, known, _account(fitted, said, places)


def _account(fitted: FittedMaterials, said: dict[str, dict[int, OfRoughness]], places: dict[int, float]) -> Account:
    """What each evidence said of the roughness: where its own cost is least (residual), or what it decided."""

    def roughness(place: float) -> float:
        return round(float(roughness_at(torch.tensor(place), fitted.preset.least_roughness)), 4)

    told: list[dict[str, dict[str, float]]] = [{} for _ in range(len(fitted))]
    for name, each in said.items():
        for k, own in each.items():
            if k not in places:  # nothing was decided for this material
                continue
            place = places[k]
            if name == Residual.name and own.cost is not None:
                place = float(place_of_least(own.cost[:, None])[0])
            told[k][name] = {"roughness": roughness(place)}
    return Account(tuple(told), _skipped(fitted))


def _places_of_dielectrics(residual: list[OfRoughness], preset: MaterialPreset) -> list[float]:
    """The places of dielectrics by the residual of their reflections alone."""
    if not residual:
        return []
    cost = torch.stack([own.cost for own in residual if own.cost is not None], 1)
    weight = torch.stack([torch.as_tensor(own.weight, device=cost.device) for own in residual])
    return place_of_least(share_roughness(cost, weight, preset.roughness_margin)).tolist()


def _places_of_colored(moments: list[OfRoughness], preset: MaterialPreset) -> list[float]:
    """The places of dielectrics of which the third moment says something."""
    both = [(m.cost, [m.log_ratio(k) for k in range(len(m.cost))]) for m in moments if m.cost is not None and m.log_ratio]
    return places_of_colored(both, preset.hue_residual_margin)


def _place_of_metal(residual: OfRoughness | None, spread: OfRoughness | None, fitted: FittedMaterials) -> float | None:
    """The place of a metal by its residual and its spread, or by one of both. None without any.

    Without a residual, all values are possible. Without a spread, the least residual decides.
    """
    cost = torch.zeros_like(fitted.cost[0, :, 0]) if residual is None or residual.cost is None else residual.cost
    if spread is not None and spread.log_ratio is not None:
        return place_of_metal(cost, fitted.preset.spread_margin, spread.log_ratio)
    return None if residual is None else float(place_of_least(cost[:, None])[0])


def decide_segments(
    residual: SegmentResidual,
    preset: MaterialPreset,
    classes: tuple[float, ...],
    chosen: np.ndarray | None,
    shift: float = 0.0,
) -> tuple[np.ndarray, Tensor]:
    """The class of each of K segments, an index [K] into `classes`, and its roughness, a place [K] in `roughness_scan`.

    `chosen` [K] are the classes, where they are known. shift: that of the dielectrics (`shift_of_dielectrics`).
    """
    if chosen is None:
        chosen = residual.of_metallic(np.array([1 + preset.segment_metal_margin * m for m in classes])).argmin(0)
    cost = residual.of_roughness(chosen, preset.segment_prior)
    place = place_of_least(torch.from_numpy(cost.T.astype(np.float32)))
    dielectric = torch.tensor(classes)[torch.from_numpy(chosen)] < 0.5
    return chosen, torch.where(dielectric, place + shift, place).clamp(0, cost.shape[1] - 1)


def shift_of_dielectrics(
    account: Account, roughness: Tensor, metallic: Tensor, shares: Sequence[float], preset: MaterialPreset
) -> float:
    """How far the third moment moves a palette's dielectrics from where their residual is least, in `roughness_scan`.

    The palette has roughness [K], metallic [K] and the shares [K]. The mean over all dielectrics, with their shares as
    weights. Those of which it says nothing are not moved. The last values may be those of blends, of which nothing was told;
    they do not count.
    """
    moved, weight = [], []
    for k, told in enumerate(account.told):
        if float(metallic[k]) > 0.5:
            continue
        before, after = told.get(Residual.name, {}).get("roughness"), float(roughness[k])
        steps = 0.0
        if before is not None and "roughness" in told.get(ThirdMoment.name, {}):
            places = place_in_scan(torch.tensor([before, after]), preset.least_roughness).tolist()
            steps = places[1] - places[0]
        moved.append(steps)
        weight.append(shares[k])
    return float(np.average(moved, weights=weight)) if sum(weight) > 0 else 0.0


def factors_of_change(change: float, class_said: float, preset: MaterialPreset) -> tuple[float, float]:
    """Factors of an error if the metallic of a material changes by `change`: by the prior, and by what regions or hues say.

    class_said is from -1 (dielectric) to 1 (metal).
    """
    return 1 + preset.metal_margin * change, 1 - preset.hue_margin * class_said * change


def share_roughness(residual: Tensor, weight: Tensor, margin: float) -> Tensor:
    """The residuals [R, K] by which the roughness is chosen: those of the materials, or the mean of those that share one.

    weight [K] is that of the samples of each material. The common roughness is that with the least weighted mean of the
    residuals. A material whose residual it raises by more than the share `margin` leaves, and the others look for a common
    roughness again. A material without weight keeps its residual.
    """
    shared, chosen = weight > 0, residual.clone()
    while int(shared.sum()) > 1:
        together = (residual[:, shared] * weight[shared]).sum(1) / weight[shared].sum()
        worse = residual[together.argmin()] / residual.amin(0).clamp_min(1e-9) - 1
        worse = torch.where(shared, worse, torch.zeros_like(worse))
        if float(worse.max()) <= margin:
            chosen[:, shared] = together[:, None]
            break
        shared = shared & (worse < worse.max())
    return chosen


def places_of_colored(evidence: Sequence[tuple[Tensor, list[float]]], margin: float) -> list[float]:
    """The place of each paint's roughness in `roughness_scan`, by its residual [R] and its log ratio of third moments [R].

    All paints share one, except those that are far apart from the others; these keep their own. A residual may be up to the
    share `margin` above its least. Within this range the third moment decides, or the mean of the logs of the third moments'
    ratios where paints share a roughness.
    """
    found = [place_by_both(residual, margin, moment.__getitem__, _ALIKE_MOMENTS) for residual, moment in evidence]
    shared = list(range(len(evidence)))
    while len(shared) > 1:
        common, leaves = _common_place([evidence[k] for k in shared], margin)
        if leaves is None:
            for k in shared:
                found[k] = common
            break
        del shared[leaves]
    return found


def _common_place(evidence: list[tuple[Tensor, list[float]]], margin: float) -> tuple[float, int | None]:
    """A place for several paints, and the index of the paint that it fits least; None if it fits all."""
    raised = torch.stack([residual / residual.min().clamp_min(1e-9) for residual, _ in evidence])
    worst = raised.amax(0)
    best = int(worst.argmin())
    if float(worst[best]) > 1 + margin:
        return float(best), int(raised[:, best].argmax())
    moment = np.mean([np.clip(own, -_MOST_LOG, _MOST_LOG) for _, own in evidence], 0)
    common = place_by_both(worst, (1 + margin) / float(worst[best]) - 1, moment.tolist().__getitem__, _ALIKE_MOMENTS)
    apart = [abs(float(np.interp(common, np.arange(len(moment)), own))) for _, own in evidence]
    return common, int(np.argmax(apart)) if max(apart) > _APART else None


def place_where_equal(residual: Tensor, margin: float, excess: Callable[[int], float]) -> float:
    """The place 0 .. R - 1 of a roughness in `roughness_scan`.

    residual [R]; all rows around the least one whose residual is at most 1 + `margin` times the least are possible.
    excess(row) is how much more the prediction varies than the photos; it falls with the roughness. The place is where it
    vanishes, or the end of the range that is nearest to that.
    """
    best, limit = int(residual.argmin()), float(residual.min()) * (1 + margin)
    low = high = best
    while low > 0 and residual[low - 1] <= limit:
        low -= 1
    while high < len(residual) - 1 and residual[high + 1] <= limit:
        high += 1
    before = excess(low)
    if before <= 0:
        return float(low)
    for row in range(low + 1, high + 1):
        after = excess(row)
        if after <= 0:
            return row - after / (after - before)
        before = after
    return float(high)


def place_by_both(residual: Tensor, margin: float, log_ratio: Callable[[int], float], alike: float) -> float:
    """The place 0 .. R - 1 of a roughness in `roughness_scan`, by the residual [R] and by another measure.

    log_ratio(row) is the log of (the measure of the prediction / that of the photos); it falls with the roughness. Within
    the range that the residual leaves, it decides (`place_where_equal`). Lobes that are sharper than the light have the
    measure of a mirror, which cannot tell them apart. So the residual does. What the residual says fades out where the
    measure falls below that of a mirror: half of it counts where the log is 0.75 `alike` lower, nothing where it is `alike`
    lower.
    """
    known = cache(log_ratio)  # it may be slow, and most materials need few rows
    place, rows = place_where_equal(residual, margin, known), np.arange(len(residual))
    beside = [int(place), min(int(place) + 1, len(rows) - 1)]
    drop = (known(0) - np.interp(place, beside, [known(row) for row in beside])) / alike
    if drop > 1:
        return place
    places = np.append(np.linspace(0, rows[-1], _PLACES * rows[-1] + 1), place)
    sharp = known(0) - np.interp(places, rows, [known(row) for row in rows.tolist()]) <= alike
    by_residual = places[sharp][np.interp(places, rows, residual.cpu().numpy())[sharp].argmin()]
    return float(place + min(2 - 2 * drop, 1.0) * (by_residual - place))


def place_of_metal(residual: Tensor, margin: float, log_ratio: Callable[[int], float]) -> float:
    """The place 0 .. R - 1 of a metal's roughness in `roughness_scan`, by the residual [R] and the spread (`place_by_both`).

    log_ratio(row) is the log of (spread of the prediction / spread of the photos). Where it is below 0 for a mirror, no lobe
    varies as much as the photos: fine relief or fine light is missing. Spreads are then wrong by that much at least, so
    spreads whose logs differ by less are not told apart.
    """
    known = cache(log_ratio)
    return place_by_both(residual, margin, known, max(_ALIKE_SPREADS, -known(0)))
