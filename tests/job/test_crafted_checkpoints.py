"""Checkpoints of a stranger: numbers out of range end no process, and small files do not become large.

Embree and our own compiled code check no indices. With the faces of these files they ended the process.
"""

from __future__ import annotations

import copy
import io
import json
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from blender_nep.checkpoints import load_state, save_state
from blender_nep.job.commands import correction
from blender_nep.job.reporting.events import Events
from blender_nep.job.stages import MaterialsStage, SurfaceResult, SurfaceStage
from blender_nep.materials.corrections import Correction, KeptMaterials
from blender_nep.materials.training import Materials
from blender_nep.surface.normal_map import LeanMesh
from support.ball_stages import BallStages, ball_surface
from support.two_materials import KeepingStages, two_materials

HUGE = 10**9


def put(state, path, value):
    *parents, last = path
    for name in parents:
        state = state[name]
    state[last] = value


def changed(array, place, value):
    """The array or tensor with another number at a place."""
    out = array.clone() if isinstance(array, torch.Tensor) else array.copy()
    out[place] = value
    return out


SURFACE = {
    "faces beyond": lambda a: a.update(faces=changed(a["faces"], (0, 0), HUGE)),
    "faces below": lambda a: a.update(faces=changed(a["faces"], (0, 0), -HUGE)),
    "faces of floats": lambda a: a.update(faces=a["faces"] + 0.5),
    "faces of squares": lambda a: a.update(faces=np.zeros((3, 4), np.int64)),
    "no faces": lambda a: a.update(faces=np.zeros((0, 3), np.int64)),
    "nan": lambda a: a.update(vertices=changed(a["vertices"], (0, 0), np.nan)),
    "few normals": lambda a: a.update(normals=a["normals"][:5]),
    "few uv": lambda a: a.update(uv=a["uv"][:5]),
    "uv far away": lambda a: a.update(uv=changed(a["uv"], (0, 0), 1e18)),
    "text": lambda a: a.update(vertices="text"),
    "another name": lambda a: a.update(other=1),
}


@pytest.fixture
def asset(start) -> Path:
    assert start(KeepingStages())[0] == 0
    return start.out


def correct(asset: Path) -> tuple[int, dict]:
    told = io.StringIO()
    code = correction.run(asset, {1: Correction(roughness=0.3)}, Events(told, io.StringIO()))
    return code, json.loads(told.getvalue().splitlines()[-1])


def test_how_bright_the_object_is_in_each_photo_comes_back(tmp_path):
    gray, gain = np.full((4, 4), 0.5, np.float32), torch.tensor([1.0, 0.8, 1.25])
    given = SimpleNamespace(scene=SimpleNamespace(rays=SimpleNamespace(views=3), device="cpu"))
    materials = Materials(np.stack([gray] * 3, -1), gray, gray, gray, object_gain=gain)
    save_state(tmp_path / "state.pt", MaterialsStage().pack(materials))
    state = load_state(tmp_path / "state.pt")
    assert torch.equal(MaterialsStage().unpack(state, given).object_gain, gain)
    assert torch.equal(MaterialsStage().unpack(state | {"object_gain": gain.numpy()}, given).object_gain, gain)
    for wrong in (gain[:2], torch.zeros(3), changed(gain, 0, np.nan), "text"):
        with pytest.raises(ValueError, match="object_gain"):
            MaterialsStage().unpack(state | {"object_gain": wrong}, given)


def packed_surface() -> dict:
    small = LeanMesh(ball_surface(), np.zeros((4, 4, 3), np.float32))
    return copy.deepcopy(SurfaceStage().pack(SurfaceResult(ball_surface(), {}, small)))


@pytest.mark.parametrize("lean", [False, True], ids=["mesh", "lean mesh"])
@pytest.mark.parametrize("name", SURFACE)
def test_a_crafted_mesh_is_refused(name, lean):
    state = packed_surface()
    arrays = state["lean"]["arrays"] if lean else state["arrays"]
    SURFACE[name](arrays)
    with pytest.raises((ValueError, TypeError)):
        SurfaceStage().unpack(state, None)
    found = SurfaceStage().unpack(packed_surface(), None)
    assert len(found.surface.faces) == len(found.of_asset.faces) == len(ball_surface().faces)


MATERIALS = {
    "label": (("materials", "label"), lambda a: changed(a, 0, HUGE)),
    "first": (("materials", "points", "first"), lambda a: changed(a, 0, -HUGE)),
    "second": (("materials", "points", "second"), lambda a: changed(a, 0, HUGE)),
    "few points": (("materials", "points", "share"), lambda a: a[:3]),
    "nan": (("materials", "points", "position"), lambda a: changed(a, (0, 0), np.nan)),
    "few colors": (("materials", "target"), lambda a: a[:3]),
    "light": (("materials", "light", "specular"), lambda a: a[:3]),
    "levels": (("materials", "light", "roughness_levels"), lambda a: a[:1]),
    "palette": (("materials", "palette", "albedo"), lambda a: a[:, :1]),
    "edge parts": (("shown", "edge_parts"), lambda a: changed(a, 0, -3)),
    "shown": (("shown", "shown"), lambda a: a[:3]),
    "texels": (("texels",), lambda _: 10**7),
    "kind": (("kind",), lambda _: "other"),
}


@pytest.mark.parametrize("name", MATERIALS)
def test_crafted_materials_are_refused(name):
    state = two_materials().state()
    path, change = MATERIALS[name]
    old = state
    for part in path:
        old = old[part]
    put(state, path, change(old))
    with pytest.raises((ValueError, KeyError)):
        KeptMaterials.from_state(state)
    assert KeptMaterials.from_state(two_materials().state()).texels == 32


@pytest.mark.parametrize("name", ["surface", "material_learning", "preview"])
def test_a_correction_tells_that_checkpoints_are_crafted(name, asset):
    assert correct(asset)[0] == 0
    path = asset / "checkpoints" / f"{name}.done.pt"
    saved = load_state(path)
    if name == "surface":
        SURFACE["faces beyond"](saved["result"]["arrays"])
    elif name == "material_learning":
        saved["result"]["kept"]["shown"] |= {"edge_parts": np.ones(3, np.int64), "shown": np.ones(3, bool)}
    else:
        saved["result"]["view"]["directions"] = np.ones((2, 3), np.float32)
    save_state(path, saved)
    before = (asset / "report.json").read_bytes()
    code, error = correct(asset)
    assert code == 2 and error["name"] == "usage.not_correctable" and "damaged" in error["message"]
    assert (asset / "report.json").read_bytes() == before


def test_a_resumed_job_does_a_crafted_stage_again(start):
    """The checkpoint is sound as a file. Its faces are not there."""
    stop_at = BallStages()
    assert start(stop_at)[0] == 0
    path = start.out / "checkpoints" / "surface.done.pt"
    saved = load_state(path)
    SURFACE["faces beyond"](saved["result"]["arrays"])
    save_state(path, saved)
    (start.out / "report.json").unlink()
    stages = BallStages()
    code, events = start(stages, resume=True)
    damaged = [event for event in events if event["event"] == "warning" and event["code"] == "job.result_damaged"]
    assert code == 0 and [event["values"]["file"] for event in damaged] == ["surface.done.pt"]
    assert load_state(path)["result"]["arrays"]["faces"].max() < HUGE


def test_a_compressed_checkpoint_is_refused(tmp_path):
    """64 MB of zeros take 64 kB."""
    save_state(tmp_path / "a.pt", {"zeros": torch.zeros(1 << 24)})
    with (
        zipfile.ZipFile(tmp_path / "a.pt") as whole,
        zipfile.ZipFile(tmp_path / "b.pt", "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for part in whole.infolist():
            packed.writestr(part.filename, whole.read(part))
    assert (tmp_path / "b.pt").stat().st_size < 1 << 20
    assert len(load_state(tmp_path / "a.pt")["zeros"]) == 1 << 24
    with pytest.raises(ValueError, match="damaged"):
        load_state(tmp_path / "b.pt")


@pytest.mark.parametrize("tensor", [torch.zeros(1).expand(1 << 40), torch.zeros(3, 3).to_sparse()], ids=["wide", "sparse"])
def test_a_tensor_that_is_larger_than_its_numbers_is_refused(tensor, tmp_path):
    torch.save({"tensor": tensor}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match="damaged"):
        load_state(tmp_path / "a.pt")


def test_an_old_form_of_checkpoints_is_refused(tmp_path):
    torch.save({"a": 1}, tmp_path / "a.pt", _use_new_zipfile_serialization=False)
    with pytest.raises(ValueError, match="damaged"):
        load_state(tmp_path / "a.pt")


def test_our_own_wide_tensors_come_back(tmp_path):
    save_state(tmp_path / "a.pt", {"wide": torch.ones(1).expand(5), "turned": torch.arange(6).reshape(2, 3).T})
    back = load_state(tmp_path / "a.pt")
    assert torch.equal(back["wide"], torch.ones(5)) and torch.equal(back["turned"], torch.arange(6).reshape(2, 3).T)
