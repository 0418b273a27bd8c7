"""Materials that vary: many paints, a gradual patina, and objects whose materials must stay uniform."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from blender_nep.geometry.uv_raster import rasterize
from blender_nep.materials.corrections import Correction, KeptMaterials
from blender_nep.materials.labels.pixel_votes import Surfels
from blender_nep.materials.samples.photo_samples import PhotoSamples
from blender_nep.materials.segments import varied_learning
from blender_nep.materials.segments.segments import Segments
from blender_nep.materials.segments.varied_materials import PlacedPixels, classes_of_segments, majority, segments_of
from support.lit_ball import PRESET, RADIUS, check_kept, learn, make_photos

MORE = replace(PRESET, samples=5000, label_pixels=9000)
FEW = replace(MORE, varied_gain=math.inf)
BRONZE, PATINA = torch.tensor([0.62, 0.4, 0.22]), torch.tensor([0.27, 0.43, 0.34])


def fields(points):
    """The number of the field [n] of each point: 24 fields around random centers."""
    center = torch.nn.functional.normalize(torch.randn(24, 3, generator=torch.Generator().manual_seed(5)), dim=-1)
    return torch.cdist(points / RADIUS, center).argmin(1)


def many_paints(points):
    """Twenty paints, and gold leaf on four fields; the gloss differs from field to field."""
    paint = torch.rand(24, 3, generator=torch.Generator().manual_seed(6)) * 0.8 + 0.05
    gold = torch.arange(24) % 6 == 0
    paint[gold] = torch.tensor([0.95, 0.7, 0.35])
    roughness = torch.where(gold, 0.2, torch.linspace(0.1, 0.35, 24))
    at = fields(points)
    return paint[at], roughness[at], gold[at].float()


def patina(points):
    """Bronze that turns green from place to place, gradually."""
    share = 0.5 + 0.5 * torch.sin(5 * points[:, 0]) * torch.cos(4 * points[:, 2])
    return BRONZE + (PATINA - BRONZE) * share[:, None], 0.2 + 0.35 * share, 1 - share


def errors(ball, result, materials):
    """Mean squared errors of albedo, roughness and metallic over the texels of the charts."""
    face, barycentric = rasterize(ball.uv, ball.faces, len(result.metallic))
    known = face >= 0
    points = np.einsum("nc,nck->nk", barycentric[known], ball.vertices[ball.faces[face[known]]])
    true = materials(torch.from_numpy(points).float())
    found = (result.albedo, result.roughness, result.metallic)
    return [float(((a[known] - b.numpy()) ** 2).mean()) for a, b in zip(found, true, strict=True)]


@pytest.fixture(scope="module")
def photos_of_paints():
    return make_photos(many_paints, views=16, side=48, rays=64)


@pytest.fixture(scope="module")
def varied(ball, photos_of_paints):
    return learn(ball, photos_of_paints, MORE)


@pytest.fixture(scope="module")
def few(ball, photos_of_paints):
    return learn(ball, photos_of_paints, FEW)


def test_many_paints_and_gold_leaf_get_materials_of_their_own(ball, varied, few):
    assert varied.report["segments"] > 50 and "segments" not in few.report
    assert few.report["skipped"]["materials that vary from place to place"]["code"] == "reason.preset"
    assert "unseen_light_gain" not in varied.report, "the photos show all light, so none was learned"
    albedo, roughness, metallic = errors(ball, varied, many_paints)
    assert albedo < 0.01 and roughness < 0.006 and metallic < 0.06
    worse = errors(ball, few, many_paints)
    assert albedo < 0.75 * worse[0] and roughness < worse[1]


@pytest.mark.slow
def test_paint_does_not_follow_the_light(ball, varied):
    """The error of the albedo must not follow the irradiance: light and shade are not paint."""
    result = varied
    face, barycentric = rasterize(ball.uv, ball.faces, len(result.metallic))
    known = face >= 0
    points = torch.from_numpy(np.einsum("nc,nck->nk", barycentric[known], ball.vertices[ball.faces[face[known]]])).float()
    true, _, metal = many_paints(points)
    white = make_photos(lambda at: (torch.ones(len(at), 3), torch.ones(len(at)), torch.zeros(len(at))), views=16, side=48)
    lit = white.radiance.sum(1) > 0
    place = white.origin[lit] + white.direction[lit] * ray_lengths(white.origin[lit], white.direction[lit])[:, None]
    near = torch.cdist(points[::7], place).argmin(1)
    irradiance = white.radiance[lit].mean(1)[near].log()
    excess = torch.from_numpy(result.albedo[known][::7]).mean(1).log() - true[::7].mean(1).log()
    paint = metal[::7] < 0.5
    assert abs(np.corrcoef(excess[paint], irradiance[paint])[0, 1]) < 0.25


def ray_lengths(origin, direction):
    """Distances at which the rays meet the ball."""
    along = -(origin * direction).sum(-1)
    return along - (along**2 - (origin**2).sum(-1) + RADIUS**2).clamp_min(0).sqrt()


@pytest.fixture(scope="module")
def without_metal(ball, photos_of_paints):
    """What is learned as if nothing were metal, and how many label pixels `segments_of` got each time; None: none."""
    colored_by = []

    def watched(samples, seed, pixels=None):
        colored_by.append(None if pixels is None else len(pixels))
        return segments_of(samples, seed, pixels)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(varied_learning, "segments_of", watched)
        result = learn(ball, photos_of_paints, replace(MORE, metallic=(0.0,), most_texels=32, label_pixels=3000))
    return result, colored_by


def test_who_knows_that_nothing_is_metal_decides_for_every_place(without_metal):
    result, _ = without_metal
    assert result.report["segments"] > 50
    assert len(result.metallic) == 64  # outlines are sharper with texels half as wide
    assert (result.metallic == 0).all() and np.isfinite(result.albedo).all()


def test_label_pixels_color_the_segments_that_are_kept(without_metal):
    """The first segments only measure the gain; samples are enough for that."""
    _, colored_by = without_metal
    assert colored_by == [None, varied_learning.PIXELS_OF_VARIED * 3000]


def test_pixels_of_a_photo_without_samples_are_left_out():
    """No light is known for them. As metals they would have the radiance of the photo and a slope of 0."""
    at = np.array([[0.0, 0, 0.7], [0.1, 0, 0.69], [0.2, 0, 0.67]])
    pixels = Surfels(at, at / RADIUS, np.array([0, 3, 1]))
    samples = Surfels(at[[0, 2]], at[[0, 2]] / RADIUS, np.array([0, 1]))
    placed = PlacedPixels.of(pixels, torch.arange(9.0).reshape(3, 3), samples, 0.01)
    assert placed.photo.tolist() == [0, 1] and placed.position.tolist() == at[[0, 2]].tolist()
    assert placed.radiance.tolist() == [[0, 1, 2], [6, 7, 8]]
    assert placed.sample[:, 0].tolist() == [0, 1] and placed.share.sum(1) == pytest.approx(1)


def test_a_speck_takes_the_class_around_it_but_a_stripe_does_not():
    """Label pixels a fifth of a photo's pixel apart; the stripe is three pixels wide."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(60) / 5, np.arange(60) / 5))
    places = cKDTree(np.stack([x, y, 0 * x], 1))
    stripe = (x > 5.9) & (x < 8.9)
    speck = np.hypot(x - 3, y - 6) < 0.3
    assert speck.sum() == 9
    assert np.array_equal(majority(places, stripe | speck, 3.0), stripe)
    assert np.array_equal(majority(places, stripe | speck, 0.4), stripe | speck)  # no vote where points lie far apart


@pytest.mark.slow
def test_a_gradual_patina_is_blended_from_unblended_materials(ball):
    result = learn(ball, make_photos(patina, views=16, side=48, rays=64), MORE)
    assert "segments" not in result.report, "two materials and their blends explain it"
    albedo, roughness, metallic = errors(ball, result, patina)
    assert albedo < 0.003 and roughness < 0.006 and metallic < 0.03
    shares = np.sort(result.metallic[result.metallic > 0.02])
    assert len(np.unique((shares * 50).astype(int))) > 30, "shares are continuous, not steps of a quarter"


@pytest.mark.parametrize("metallic", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_uniform_object_stays_uniform(ball, metallic):
    def uniform(points):
        n = len(points)
        return torch.tensor([0.7, 0.45, 0.2]).expand(n, 3), torch.full((n,), 0.2), torch.full((n,), metallic)

    result = learn(ball, make_photos(uniform, views=16, side=48, rays=64), MORE)
    assert result.report["skipped"]["materials that vary from place to place"]["code"] == "reason.palette_explains"
    assert np.ptp(result.albedo, axis=(0, 1)).max() < 1e-3 and np.ptp(result.roughness) < 1e-3


def shown_at(position, radiance):
    """Photo samples at positions [n, 3] with radiance [n, 3]; nothing else of them counts here."""
    n = len(position)
    unused, photo = torch.zeros(n, 3), torch.zeros(n, dtype=torch.int64)
    return PhotoSamples(np.zeros(n, int), np.zeros((n, 3)), position, unused, photo, radiance, torch.zeros(n), {})


def test_a_thin_outline_gets_its_own_segments_by_color():
    """The outline is narrower than the distance between samples, and wider than that between label pixels."""
    random = np.random.default_rng(3)

    def seen(count):
        position = np.concatenate([random.uniform(-0.5, 0.5, (count, 2)), np.zeros((count, 1))], 1).astype(np.float32)
        on_line = np.abs(position[:, 0]) < 0.008
        return shown_at(position, torch.from_numpy(np.where(on_line[:, None], 0.03, 0.6)).expand(-1, 3)), on_line

    samples, on_line = seen(4000)
    pixels, _ = seen(60_000)

    def pure(segments):
        """Share of the outline's samples whose segment shows the outline alone."""
        share = np.bincount(segments.label, on_line) / np.bincount(segments.label)
        return float((share[segments.label[on_line]] > 0.9).mean())

    assert pure(segments_of(samples, 0, pixels)) > 0.8
    assert pure(segments_of(samples, 0)) < 0.2


def test_what_is_kept_of_segments_survives_the_disk(ball, varied, tmp_path):
    check_kept(varied.kept, ball, tmp_path / "kept.pt", MORE)
    segments = varied.kept.materials
    moved = replace(varied.kept, materials=replace(segments, varied=replace(segments.varied, shift=-2.0)))
    assert KeptMaterials.from_state(moved.state()).materials.varied.shift == -2.0


def test_segments_are_listed_in_few_groups_of_one_class(varied):
    assert varied.report["segments"] > 50
    groups, palette = varied.kept.materials.group, varied.kept.materials.varied.palette
    listed = varied.kept.listed()
    assert 4 <= len(listed) <= 12 and sum(entry["share"] for entry in listed) == pytest.approx(1, abs=0.01)
    assert [entry["share"] for entry in listed] == sorted((entry["share"] for entry in listed), reverse=True)
    for number, entry in enumerate(listed):
        assert (palette.metallic.numpy()[groups == number] == entry["metallic"]).all()


def test_a_group_of_segments_is_corrected_and_the_others_stay(ball, varied):
    listed = varied.kept.listed()
    gold = next(k for k, entry in enumerate(listed) if entry["metallic"] == 1)
    restored = KeptMaterials.from_state(varied.kept.state())
    (_, roughness, metallic, _), corrected = restored.bake(ball, {gold: Correction(metallic=0.0, roughness=0.7)}, MORE)
    assert corrected[gold]["metallic"] == 0 and corrected[gold]["roughness"] == pytest.approx(0.7, abs=1e-4)
    changed = (varied.metallic > 0.99) & (metallic < 0.01)
    assert changed.mean() > 0.02 and np.abs(roughness[changed] - 0.7).max() < 0.1
    for k in set(range(len(listed))) - {gold}:
        assert corrected[k] == listed[k]
    others = (varied.metallic < 0.01) & (np.abs(roughness - 0.7) > 0.1)
    assert np.abs(metallic - varied.metallic)[others].max() < 0.01


@pytest.mark.parametrize(
    ("metal", "correction"), [(0, Correction(roughness=0.9)), (1, Correction(metallic=0.0)), (1, Correction(0.0, 0.9))]
)
def test_segments_that_are_not_named_keep_their_roughness(varied, metal, correction):
    materials = varied.kept.materials
    number = next(k for k, entry in enumerate(materials.listed()) if entry.metallic == metal)
    corrected = materials.corrected({number: correction}, MORE)
    before, after = materials.labeled(MORE), corrected.labeled(MORE)
    named = after.metallic != before.metallic if correction.roughness is None else np.abs(after.roughness - 0.9) < 1e-5
    assert 0.02 < named.mean() < 0.5
    np.testing.assert_array_equal(after.roughness[~named], before.roughness[~named])
    np.testing.assert_array_equal(after.metallic[~named], before.metallic[~named])


def test_the_list_has_the_albedo_of_a_corrected_roughness(varied):
    materials = varied.kept.materials
    gold = next(k for k, entry in enumerate(materials.listed()) if entry.metallic == 1)
    corrected = materials.corrected({gold: Correction(roughness=0.9)}, MORE)
    points = corrected.labeled(MORE)
    shown = points.albedo[np.abs(points.roughness - 0.9) < 1e-5].mean(0)
    learned, listed = (np.array(each.listed()[gold].albedo) for each in (materials, corrected))
    assert np.abs(listed - shown).max() < 0.3 * np.abs(learned - shown).max()


def test_a_segment_has_the_class_of_most_of_its_samples():
    segments = Segments(np.zeros((4, 7)), np.array([0, 0, 0, 1, 1, 2, 2, 2]))
    metal = np.array([True, True, False, False, True, False, False, True])
    assert classes_of_segments(metal, segments).tolist() == [1, 0, 0, 0], "half is not most, and nothing is no metal"


@pytest.mark.slow
def test_tarnish_varies_within_places_of_metal(ball):
    """Photos that tell classes badly: edges of color say what is metal, and its albedo varies there."""

    def tarnished(points):
        metal = (points[:, 0] < 0.2).float()[:, None]
        bright = 0.6 + 0.35 * torch.sigmoid(6 * points[:, 1:2])
        albedo = metal * bright * torch.tensor([0.9, 0.7, 0.4]) + (1 - metal) * torch.tensor([0.1, 0.15, 0.5])
        return albedo, 0.2 + 0.1 * (1 - metal[:, 0]), metal[:, 0]

    unclear = replace(MORE, unclear_classes=0.0, varied_gain=9.0, varied_gain_of_both=-9.0)
    found = learn(ball, make_photos(tarnished), unclear)
    assert found.report["segments"] > 50 and found.report["varied_gain"] < unclear.varied_gain
    face, barycentric = rasterize(ball.uv, ball.faces, len(found.metallic))
    known = face >= 0
    points = np.einsum("nc,nck->nk", barycentric[known], ball.vertices[ball.faces[face[known]]])
    clear = np.abs(points[:, 0] - 0.2) > 0.08
    metal = points[clear, 0] < 0.2
    assert ((found.metallic[known][clear] > 0.5) == metal).mean() > 0.97
    shown = found.albedo[known][clear][metal, 0]
    truth = 0.9 * (0.6 + 0.35 / (1 + np.exp(-6 * points[clear][metal, 1])))
    assert np.corrcoef(shown, truth)[0, 1] > 0.95 and np.abs(shown - truth).mean() < 0.06


@pytest.mark.slow
def test_tarnish_varies_on_an_object_of_metal(ball):
    """Its class is not in doubt, so segments that explain a little more are enough, and all of them are metal."""

    def tarnished(points):
        bright = 0.65 + 0.35 * torch.sin(8 * points[:, :1]) * torch.cos(5 * points[:, 1:2])
        return bright * torch.tensor([0.9, 0.7, 0.4]), torch.full((len(points),), 0.25), torch.ones(len(points))

    found = learn(ball, make_photos(tarnished), MORE)
    assert found.report["segments"] > 50
    assert MORE.varied_gain_of_metal < found.report["varied_gain"] < MORE.varied_gain
    assert (found.metallic > 0.99).all()
    few = learn(ball, make_photos(tarnished), FEW)
    assert errors(ball, found, tarnished)[0] < 0.3 * errors(ball, few, tarnished)[0]


@pytest.mark.slow
def test_paints_vary_beside_metal_of_the_palette(ball, photos_of_paints, few, monkeypatch):
    """Below the gain from which segments tell their classes, the palette and edges of color tell them."""
    searches, found = [], varied_learning.VariedLearning.found

    def noted(self, search, palette, unseen_learned):
        searches.append((search, palette))
        return found(self, search, palette, unseen_learned)

    monkeypatch.setattr(varied_learning.VariedLearning, "found", noted)
    worse = errors(ball, few, many_paints)
    varied = learn(ball, photos_of_paints, replace(MORE, varied_gain=9.0))
    more = errors(ball, varied, many_paints)
    assert varied.report["segments"] > 50 and varied.report["varied_gain"] >= MORE.varied_gain_of_both
    assert more[0] < 0.6 * worse[0] and more[2] < 0.03
    search, palette = searches[0]
    held_out = torch.from_numpy(np.random.default_rng(0).random(len(palette.label)) < 0.25)
    free = replace(palette, metal=None)
    black = replace(search.samples, radiance=torch.where(held_out[:, None], 0.0, search.samples.radiance))
    one, other = (at.labels_by_others(free, held_out) for at in (search, replace(search, samples=black)))
    assert torch.equal(one, other), "what the photos show of themselves does not count"
    assert torch.equal(one[~held_out], palette.label[~held_out])
    metal = palette.palette.metallic > 0.5
    assert (metal[one] == metal[palette.label]).float().mean() > 0.9
    assert search.metal_by_colors(palette.palette) is not None
    alone = replace(search, preset=replace(search.preset, unclear_classes=math.inf))
    assert alone.metal_by_colors(palette.palette) is None
