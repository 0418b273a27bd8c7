"""The checks of the stress tests: what must hold after every job, even on a hostile capture.

A failure is a line "kind: details". A campaign counts the failures of each kind.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import OpenEXR
import torch
import trimesh

from benchmarks.stress.scenes import Case, turns
from blender_nep.asset.export import TEXTURES
from blender_nep.checkpoints import load_state
from blender_nep.job.stage_names import StageName

FILES = (
    "mesh.obj",
    "mesh.mtl",
    "asset.glb",
    "environment.exr",
    "preview.png",
    "report.json",
    *(f"textures/{name}{suffix}" for name in TEXTURES for suffix in (".exr", ".png")),
)
ROUNDING = 1e-9
"""Signed volume, in cubic radii, that rounding may give a flat mesh."""
MOST_TURNED = 1e-3
"""Largest error of an entry of a rotation matrix of a turntable"""
REPAIRS = {
    "nan": "capture.pixels_not_finite",
    "inf": "capture.pixels_not_finite",
    "most_nan": "capture.pixels_not_finite",
    "negative": "capture.pixels_negative",
    "huge": "capture.pixels_too_bright",
    "one_black": "capture.photos_black",
}
"""Defect of the pixels of OpenEXR photos -> the code of the warning that must be in the report."""


def strict_json(text: str) -> dict:
    """Read JSON. Raises ValueError for NaN and Infinity, which are not JSON, but which Python's reader accepts."""

    def refuse(name: str) -> None:
        raise ValueError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def check_refusal(code: int, events: list[dict], human: str, out: Path) -> list[str]:
    """The failures of a job that ended with an exit code other than 0.

    The job must give one clear message and a documented exit code, and must leave no report of an asset.
    """
    failures = []
    errors = [e for e in events if e["event"] == "error"]
    if code == 1:
        failures.append(f"exit code 1: {errors[-1]['message'] if errors else 'no message'}")
    elif code not in (2, 3, 4, 5, 6):
        failures.append(f"undocumented exit code: {code}")
    if len(errors) != 1 or errors[0]["code"] != code or "\n" in errors[0]["message"] or not errors[0]["message"]:
        failures.append(f"unclear error: {errors}")
    elif code != 1 and ("Traceback" in human or "nan" in re.findall("[a-z]+", errors[0]["message"])):
        failures.append(f"unclear error: {errors[0]['message']}")
    if (out / "report.json").exists():
        failures.append("half an asset: report.json after an error")
    return failures


def check_asset(case: Case, out: Path) -> list[str]:
    """The failures of an asset.

    The asset must be complete, its values finite and in range, its mesh inside the bounds. Its report must name all repairs.
    """
    missing = [name for name in FILES if not (out / name).is_file()]
    if missing:
        return [f"incomplete asset: {missing}"]
    try:
        report = strict_json((out / "report.json").read_text())
    except ValueError as error:
        return [f"bad report: {error}"]
    failures = []
    for name in TEXTURES:
        texture = _exr(out / "textures" / f"{name}.exr")
        if not np.isfinite(texture).all() or texture.min() < 0 or texture.max() > 1:
            failures.append(f"bad texture: {name} {texture.min()}..{texture.max()}")
    light = _exr(out / "environment.exr")
    if not np.isfinite(light).all() or light.min() < 0:
        failures.append(f"bad environment: {light.min()}..{light.max()}")
    center, radius = np.array(report["capture"]["object_center"]), report["capture"]["object_radius"]
    failures += check_mesh(out, center, radius, report)
    for file in sorted((out / "checkpoints").glob("*.done.pt")):
        bad = [name for name, value in _tensors(load_state(file)) if not np.isfinite(value).all()]
        if bad:
            failures.append(f"not finite on disk: {file.name} {bad[:3]}")
    return failures + check_report(case, report) + check_turntable(case, out, report)


def check_turntable(case: Case, out: Path, report: dict) -> list[str]:
    """The failures of what the asset says about a turntable: cameras.json must tell how the object was turned.

    A walk that is said to be a turntable has no photos that fit. So it must not end with an asset.
    """
    if case.turntable == "walk":
        return ["false turntable: a walk was taken for one"]
    frames = json.loads((out / "cameras.json").read_text())["frames"]
    moved = ["object_to_room" in frame for frame in frames]
    used = bool(report["scene"]["photos"].get("turntable"))
    if used != all(moved) or used != any(moved) or (case.turntable == "told" and not used):
        return [f"turntable forgotten: {used} in the report, {sum(moved)} of {len(frames)} motions"]
    if not used:
        return []
    true = turns(case)[[int(Path(frame["file_path"]).stem) for frame in frames]]
    found = np.array([frame["object_to_room"] for frame in frames])[:, :3, :3]
    wrong = float(np.abs(found - true[0].T @ true).max())
    return [f"wrong turns: by {wrong:.4f}"] if wrong > MOST_TURNED else []


def check_mesh(out: Path, center: np.ndarray, radius: float, report: dict) -> list[str]:
    """The failures of the mesh: mesh.obj must lie in the object's sphere and face outward, and asset.glb must equal it."""
    failures = []
    vertices, normals, faces = [], [], []
    for line in (out / "mesh.obj").read_text().splitlines():
        key, *rest = line.split(" ")
        if key in ("v", "vn"):
            (vertices if key == "v" else normals).append([float(x) for x in rest])
        elif key == "f":
            faces.append([int(corner.split("/")[0]) - 1 for corner in rest])
    unit, normals = (np.array(vertices) - center) / radius, np.array(normals)
    if not len(unit) or not np.isfinite(unit).all() or not np.isfinite(normals).all():
        return ["bad mesh: empty or not finite"]
    if np.abs(np.linalg.norm(normals, axis=1) - 1).max() > 1e-3:
        failures.append("bad mesh: a normal is not of unit length")
    failures += check_outward(unit, np.array(faces))
    given = "surface extraction" in report["skipped"]
    if np.linalg.norm(unit, axis=1).max() > (2.0 if given else 1.001):
        failures.append(f"bad mesh: reaches {np.linalg.norm(unit, axis=1).max():.4f} radii")
    scene = trimesh.load(out / "asset.glb", process=False)
    glb = np.concatenate(
        [
            trimesh.transform_points(scene.geometry[name].vertices, matrix)
            for matrix, name in (scene.graph[node] for node in scene.graph.nodes_geometry)
        ]
    )
    glb = (glb @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T - center) / radius
    if glb.shape != unit.shape or np.abs(glb - unit).max() > 1e-3:
        off = np.abs(glb - unit).max() if glb.shape == unit.shape else "other vertices"
        failures.append(f"asset.glb is not mesh.obj: {off}")
    distinct = len(np.unique(np.round(unit, 6), axis=0))
    known = out / "checkpoints" / "surface.done.pt"
    if known.is_file():
        inner = load_state(known)["result"]["arrays"]["vertices"]
        if inner.shape != unit.shape or np.abs(inner - unit).max() > 1e-4:
            failures.append(
                "coarse mesh.obj: vertices lost more than 1e-4 radii to their text "
                f"({np.abs(inner - unit).max() if inner.shape == unit.shape else 'other'})"
            )
    if distinct < 4:
        failures.append(f"bad mesh: {distinct} places")
    return failures


def check_outward(vertices: np.ndarray, faces: np.ndarray) -> list[str]:
    """The failure of a closed mesh (vertices [V, 3], faces [F, 3]) that is inside out: its signed volume is negative.

    A mesh that was given inside out must have been turned. Vertices at one place count as one, because the UV map splits
    them. Nothing is said of an open mesh. It has an edge that fewer faces run along in one direction than in the other.
    """
    places, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces]
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    if not np.array_equal(np.sort(start * len(places) + end), np.sort(end * len(places) + start)):
        return []
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    return [f"bad mesh: inside out, its volume is {volume:.3g}"] if volume < -ROUNDING else []


def check_report(case: Case, report: dict) -> list[str]:
    """The failures of the report: its warnings must name everything that was repaired."""
    failures, said = [], [warning["code"] for warning in report["warnings"]]
    wanted = REPAIRS.get(case.pixels) if case.suffix == ".exr" else {"one_black": "capture.photos_black"}.get(case.pixels)
    if case.masks == "alpha" and case.pixels in ("negative", "huge"):
        wanted = None  # all bad pixels may lie where alpha is 0
    if wanted and wanted not in said:
        failures.append(f"silent repair: {case.pixels} pixels are not in the warnings ({said})")
    if case.duplicates in ("some", "pairs") and "capture.same_place" not in said:
        failures.append(f"silent repair: duplicate cameras are not in the warnings ({said})")
    skipped = (report["stages"].get(StageName.FIELDS_LEARNING) or {}).get("steps_not_finite", 0)
    if skipped and "job.steps_left_out" not in said:
        failures.append("silent repair: steps that were left out are not in the warnings")
    return failures


def same_assets(a: Path, b: Path) -> list[str]:
    """The failures of two assets that must be equal bit for bit."""
    names = [n for n in FILES if not n.endswith((".glb", "report.json", ".png"))]
    different = [
        n
        for n in names
        if n != "environment.exr" and not n.startswith("textures/") and (a / n).read_bytes() != (b / n).read_bytes()
    ]
    different += [n for n in names if n.endswith(".exr") and not np.array_equal(_exr(a / n), _exr(b / n))]
    for stage in (StageName.FIELDS_LEARNING, StageName.SURFACE, StageName.MATERIAL_LEARNING):
        files = [f / "checkpoints" / f"{stage}.done.pt" for f in (a, b)]
        if all(f.is_file() for f in files):
            one, other = (dict(_tensors(load_state(f)["result"])) for f in files)
            different += [f"{stage}{k}" for k in one if k not in other or not np.array_equal(one[k], other[k])]
    return [f"resumed run differs: {different[:6]}"] if different else []


def _exr(path: Path) -> np.ndarray:
    (channel,) = OpenEXR.File(str(path)).channels().values()
    return np.asarray(channel.pixels, np.float32)


def _tensors(value, name: str = ""):
    """Yield (name, array) for every tensor and array in a nested state."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _tensors(item, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from _tensors(item, f"{name}[{i}]")
    elif isinstance(value, torch.Tensor | np.ndarray):
        yield name, np.asarray(value)
