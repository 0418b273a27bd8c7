"""Whole small jobs on hostile captures (benchmarks/stress/campaign.py has the campaign), and the guards that they led to."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, Phase, given, settings

from benchmarks.scoring.geometry import Body
from benchmarks.stress.campaign import cases, digest, reconstruct, run_case, summarize
from benchmarks.stress.checks import check_asset, same_assets
from benchmarks.stress.scenes import Case, signed_distance, trace, write_capture
from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import load_state
from blender_nep.errors import LearningError
from blender_nep.fields.non_finite_monitor import PATIENCE, NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.training import FieldsLearning
from blender_nep.geometry.mesh import weld
from blender_nep.materials.corrections import KeptMaterials
from blender_nep.optimizers import Adam, UniformAdam
from blender_nep.scene.scene import Scene

PLAIN = Case(told="yes", pixels="saturated", suffix=".png")


@pytest.mark.slow
@settings(
    max_examples=10,
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(case=cases())
def test_a_hostile_case_gives_a_sound_asset_or_a_clear_refusal(tmp_path_factory, case):
    row = run_case(case, tmp_path_factory.mktemp(digest(case)))
    assert not row["failures"], json.dumps({k: v for k, v in asdict(case).items() if v != getattr(Case(), k)})


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(Case(bfloat16=True, told="yes"), marks=pytest.mark.slow),
        pytest.param(Case(offset=1e6, told="yes"), marks=pytest.mark.slow),
        Case(offset=1e6, scale=1e-4, told="no", metallic=0.0),
        Case(duplicates="pairs", told="yes", pixels="negative"),
        Case(distance=100.0, told="yes", pixels="huge"),
        Case(mesh="soup", told="yes", pixels="nan", views=3),
        pytest.param(Case(turntable="told", told="yes"), marks=pytest.mark.slow),
    ],
    ids=lambda case: digest(case),
)
def test_cases_that_failed_once_or_that_the_issue_names(tmp_path, case):
    row = run_case(case, tmp_path)
    assert row["code"] == 0 and not row["failures"]


def test_a_walk_that_is_said_to_be_a_turntable_is_refused(tmp_path):
    row = run_case(Case(turntable="walk"), tmp_path)
    assert row["code"] == 3 and not row["failures"]


@pytest.mark.parametrize("turntable", ["told", "untold", "walk"])
def test_a_row_of_a_turntable_shows_the_same_room(tmp_path, turntable):
    write_capture(Case(turntable=turntable, shape="nothing", views=8, size=16), tmp_path)
    meta = json.loads((tmp_path / "transforms.json").read_text())
    capture = load_capture(tmp_path)
    rays = PixelRays.from_capture(capture, 900, True)
    photos = rays.radiance.view(8, -1)
    for row in (photos[:4], photos[4:]):
        assert bool((row - row[0]).abs().max() < 1e-5) == (turntable != "walk")
    assert (photos[0] - photos[4]).abs().max() > 0.01, "the camera is higher in the second row"
    assert meta.get("turntable", False) == (turntable != "untold")
    places = np.array([view.camera.camera_to_world[:3, 3] for view in capture.views])
    assert len(np.unique(places.round(6), axis=0)) == 8


@pytest.fixture(scope="module")
def plain_asset(tmp_path_factory):
    """The asset of a plain case, and its surface in the unit frame."""
    folder = tmp_path_factory.mktemp("plain")
    write_capture(PLAIN, folder / "capture")
    assert reconstruct(PLAIN, folder / "capture", folder / "asset")[0] == 0
    return folder / "asset"


def unit_surface(asset):
    return load_state(asset / "checkpoints" / "surface.done.pt")["result"]["arrays"]["vertices"]


def test_a_scene_scaled_by_a_power_of_two_gives_the_same_bits(plain_asset, tmp_path):
    """Nothing in the library may depend on the capture's unit: the unit frame is exact then, and so is everything else."""
    case = replace(PLAIN, scale=2.0**-13)
    write_capture(case, tmp_path / "capture")
    assert reconstruct(case, tmp_path / "capture", tmp_path / "asset")[0] == 0
    np.testing.assert_array_equal(unit_surface(plain_asset), unit_surface(tmp_path / "asset"))
    for stage in ("fields_learning", "material_learning"):
        one, other = (
            load_state(a / "checkpoints" / f"{stage}.done.pt")["result"] for a in (plain_asset, tmp_path / "asset")
        )
        if stage == "material_learning":
            assert all(np.array_equal(one["textures"][k], other["textures"][k]) for k in one["textures"])
        else:
            assert torch.equal(one["environment"]["raw"], other["environment"]["raw"])


def test_a_scene_moved_a_million_units_gives_the_same_fields(plain_asset, tmp_path):
    case = replace(PLAIN, offset=1e6)
    write_capture(case, tmp_path / "capture")
    rays = []
    for folder in (plain_asset.parent / "capture", tmp_path / "capture"):
        rays.append(PixelRays.from_capture(load_capture(folder), 900, True))
    learned = []
    for these in rays:
        learning = FieldsLearning(Scene.of(these), PLAIN.settings(tmp_path, tmp_path).preset, 0)
        for _ in range(20):
            learning.learn_step()
        assert learning.schedule.learned > 10
        learned.append(learning)
    one, other = (learning.object_field.coefficients().detach() for learning in learned)
    # rays differ by 1e-7; after a dozen steps of the SDF, each of at most 0.003, it may not by more than a thousandth
    assert (one - other).abs().max() < 1e-5


def test_one_thread_and_many_give_the_same_asset_within_rounding(plain_asset, tmp_path):
    """Sums may be taken in another order, and nothing else.

    Rounding may swap two edges of nearly the same cost in the simplification, and with them places and order of vertices and
    the UV map. So what the textures are baked from is compared, points of the surface with their materials, and how far the
    vertices of each mesh are from the surface of the other one.
    """
    assert PLAIN.threads == 1
    assert reconstruct(replace(PLAIN, threads=4), plain_asset.parent / "capture", tmp_path / "4")[0] == 0
    found = []
    for out in (plain_asset, tmp_path / "4"):
        stages = {
            name: load_state(out / "checkpoints" / f"{name}.done.pt")["result"]
            for name in ("fields_learning", "material_learning")
        }
        sdf = stages["fields_learning"]["object"]["weights"]["levels.2"]
        kept = KeptMaterials.from_state(stages["material_learning"]["kept"]).materials
        points = vars(kept.labeled(PLAIN.settings(out, out).preset.material))
        arrays = load_state(out / "checkpoints" / "surface.done.pt")["result"]["arrays"]
        found.append(({"sdf": sdf} | points, Body(*weld(arrays["vertices"], arrays["faces"])[:2])))
    (one, surface), (other, others) = found
    assert all(np.shape(one[name]) == np.shape(other[name]) for name in one)
    assert not [name for name in one if np.abs(np.asarray(one[name]) - np.asarray(other[name])).max() > 1e-3]
    assert len(surface.mesh.vertices) == len(others.mesh.vertices)  # welded: another UV map has its seams elsewhere
    # The vertices themselves are 0.0010 apart where an edge was swapped; the surfaces are 0.0003 apart there.
    assert max(a.distance(b.mesh.vertices).max() for a, b in ((surface, others), (others, surface))) < 5e-4


def test_another_seed_gives_another_asset_of_the_same_thing(plain_asset, tmp_path):
    case = replace(PLAIN, seed=2**32 + 5)
    assert reconstruct(case, plain_asset.parent / "capture", tmp_path / "asset")[0] == 0
    assert not check_asset(case, tmp_path / "asset")
    assert same_assets(plain_asset, tmp_path / "asset"), "the seed decides nothing"
    radii = [np.linalg.norm(unit_surface(a), axis=1).mean() for a in (plain_asset, tmp_path / "asset")]
    assert abs(radii[0] - radii[1]) < 0.1


def test_the_shapes_are_traced_where_they_are():
    rng = np.random.default_rng(0)
    for shape in ("sphere", "box", "plate", "ring", "holes"):
        origins = rng.normal(size=(400, 3))
        origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
        directions = rng.uniform(-0.5, 0.5, (400, 3)) - origins
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        t, normal = trace(shape, origins, directions)
        hit = np.isfinite(t)
        assert hit.sum() > 20 and (np.einsum("ij,ij->i", normal[hit], directions[hit]) < 0.2).all()
        along = np.linspace(1.5, 4.5, 3000)
        nearest = np.stack([signed_distance(shape, origins + s * directions) for s in along]).min(0)
        # a ray that crawls along an edge may need more steps than it has
        assert (nearest[hit] < 2e-3).all() and (nearest[~hit] < -2e-3).sum() <= 2


def test_a_summary_counts_what_failed():
    rows = {
        "a": {
            "case": asdict(Case(scale=1e4)),
            "code": 0,
            "failures": ["bad mesh: x"],
            "message": "",
            "warnings": ["w"],
            "seconds": 1.0,
            "resumed": True,
        },
        "b": {
            "case": asdict(Case()),
            "code": 4,
            "failures": [],
            "message": "3 of 4 cameras",
            "warnings": [],
            "seconds": 2.0,
            "resumed": False,
        },
    }
    found = summarize(rows)
    assert found["cases"] == 2 and found["failed"] == ["a"] and found["failures_by_kind"] == {"bad mesh": 1}
    assert found["exit_codes"] == {"0": 1, "4": 1} and found["refusals"] == {"# of # cameras": 1}
    assert found["met"] == {"scale=10000.0": 1} and found["resumed"] == 1


def test_the_monitor_gives_up_after_many_failures_and_counts_all():
    monitor = NonFiniteMonitor()
    for k in range(3 * PATIENCE):
        assert monitor.record(k % PATIENCE == 0) == (k % PATIENCE == 0)
    assert monitor.left_out == 3 * (PATIENCE - 1)
    copy = NonFiniteMonitor()
    copy.load(monitor.state())
    assert not monitor.record(True) or copy.state() != monitor.state()
    with pytest.raises(LearningError, match="not finite"):
        copy.record(False)
    assert [usable_loss(x) for x in (0.1, float("nan"), float("inf"), -1e9)] == [True, False, False, False]


def test_a_gradient_that_is_not_finite_changes_nothing(plain_asset):
    """A finite loss may have a gradient that is not; one such step would stay in Adam's moments for ever."""
    rays = PixelRays.from_capture(load_capture(plain_asset.parent / "capture"), 900, True)
    learning = FieldsLearning(Scene.of(rays), PLAIN.settings(plain_asset, plain_asset).preset, 0)
    while learning.schedule.learned < 3:  # in the step before, F_e got a finer grid
        learning.learn_step()
    parameter = learning.object_field.levels[0]
    hook = parameter.register_hook(lambda gradient: gradient * float("nan"))
    before = [p.detach().clone() for p in (*learning.object_field.parameters(), learning.environment.raw)]
    learning.learn_step()
    hook.remove()
    after = [*learning.object_field.parameters(), learning.environment.raw]
    assert learning.monitor.left_out == 1 and all(torch.equal(a, b) for a, b in zip(before, after, strict=True))
    learning.learn_step()
    assert learning.monitor.left_out == 1 and not torch.equal(before[0], parameter)
    assert all(torch.isfinite(p).all() for p in after)


def test_gradients_are_usable_only_when_all_are_finite():
    one, other = torch.nn.Parameter(torch.ones(3)), torch.nn.Parameter(torch.ones(2))
    optimizers = [UniformAdam([one], lr=1.0), Adam([other])]
    assert usable_gradients(optimizers)
    one.grad, other.grad = torch.full((3,), 3e38), torch.zeros(2)
    assert usable_gradients(optimizers), "finite ones whose sum float32 cannot hold"
    other.grad[1] = float("inf")
    assert not usable_gradients(optimizers)
