"""An executable that plays the engine's Python for `blender_nep materials`, and an asset that it can correct.

It writes its arguments to arguments.json beside itself. Then it does what the file `mode` beside it says: well (or no such
file): it writes the asset's roughness and metallic textures and its report with the corrections. refuse: it reports an
error. full: it reports a full disk. old: it does not know the command. crash: it kills itself. slow: it waits until the file
`go` is there, and does its work then.
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from support.captures import write_exr
from support.executable import write_executable

SCRIPT = """
import json, os, pathlib, signal, sys, time
import numpy as np
from PIL import Image
assert sys.argv[1:5] == ["-I", "-m", "blender_nep", "materials"], sys.argv
here, asset = pathlib.Path(__file__).parent, pathlib.Path(sys.argv[5])
(here / "arguments.json").write_text(json.dumps(sys.argv[6:]))
mode = (here / "mode").read_text() if (here / "mode").exists() else "well"
def say(**event):
    print(json.dumps(event), flush=True)
if mode == "old":
    sys.exit("blender-nep: error: argument {info,reconstruct}: invalid choice: 'materials' (choose from info, reconstruct)")
say(event="progress", stage="material_learning", step=1, steps=2, fraction=0.5, eta_s=10)
if mode == "slow":
    while not (here / "go").exists():
        time.sleep(0.02)
if mode == "crash":
    os.kill(os.getpid(), signal.SIGKILL)
if mode == "refuse":
    say(event="error", code=2, name="usage", values={}, message="the light was not kept", hint="Reconstruct again.")
    sys.exit(2)
if mode == "full":
    say(event="error", code=5, name="output.disk_full", values={"path": "/a"}, message="the disk is full", hint="--resume")
    sys.exit(5)
report = json.loads((asset / "report.json").read_text())
corrections = {}
for option, given in zip(sys.argv[6::2], sys.argv[7::2]):
    assert option == "--set"
    number, _, value = given.partition(":")
    corrections.setdefault(number, {})[value.split("=")[0]] = float(value.split("=")[1])
assert corrections or sys.argv[6:] == ["--reset"]
for number, material in enumerate(report["materials"]):
    material |= material["learned"] | corrections.get(str(number), {})
report["corrections"] = corrections
for name in ("roughness", "metallic"):
    values = [round(255 * material[name]) for material in report["materials"]]
    Image.fromarray(np.tile(np.array(values, np.uint8), (8, 1))).save(asset / "textures" / (name + ".png"))
say(event="warning", code="job.of_tomorrow", values={}, message="the light is weak")
(asset / "report.json").write_text(json.dumps(report))
say(event="done", asset=str(asset))
"""

MATERIALS = [
    {"share": 0.62, "albedo": [0.8, 0.2, 0.1], "roughness": 0.5, "metallic": 0},
    {"share": 0.3, "albedo": [0.9, 0.7, 0.3], "roughness": 0.1, "metallic": 1},
    {"share": 0.08, "albedo": [0.0, 0.2, 1.0], "roughness": 0.3, "metallic": 0},
]
"""The materials of the asset, before they are corrected."""

MESH = "v 0 0 1\nv 1 0 1\nv 0 1 2\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


def make(folder: Path) -> str:
    """Write the executable; returns its path."""
    return write_executable(folder / "correcting-engine-python", SCRIPT)


def make_asset(folder: Path) -> Path:
    """Write an asset of one triangle. Its textures are one column of texels a material wide."""
    (folder / "textures").mkdir(parents=True)
    (folder / "mesh.obj").write_text(MESH)
    for name in ("albedo", "roughness", "metallic", "confidence"):
        values = [round(255 * material.get(name, 0.5)) if name != "albedo" else 128 for material in MATERIALS]
        Image.fromarray(np.tile(np.array(values, np.uint8), (8, 1))).save(folder / "textures" / f"{name}.png")
        write_exr(folder / "textures" / f"{name}.exr", np.full((8, 3, 3), 0.5))
    write_exr(folder / "environment.exr", np.full((8, 16, 3), 0.5))
    write_report(folder, MATERIALS)
    return folder


def write_report(asset: Path, materials: list[dict], corrections: dict | None = None) -> None:
    """Write a report with these materials, which are as they were learned."""
    described = [
        {**material, "learned": {name: material[name] for name in ("roughness", "metallic")}} for material in materials
    ]
    report = {"preset": "preview", "materials": described}
    if corrections is not None:
        report["corrections"] = corrections
    (asset / "report.json").write_text(json.dumps(report))
