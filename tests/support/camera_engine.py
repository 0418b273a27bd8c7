"""An executable that plays the engine's Python for `blender_nep cameras`, and photos for it.

Of a video, it puts the photos into the folder that --out names, which it makes.
It writes its arguments to arguments.json beside itself. Then it does what the file `mode` beside it says: well (or no such
file): it writes transforms.json into the folder of photos, and leaves the last photo out. sure: the same with all photos.
improve: it says that it has improved the cameras.
fail: it reports that no cameras were found. locked: it reports that the folder may not be written. old: it does not know
the command. crash: it kills itself. slow: it waits until the file `go` is there, or until it is stopped; then it writes the
file `stopped` with the reason. deaf: it does not know how to stop.
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from support.captures import look_at
from support.executable import write_executable

SCRIPT = """
import json, os, pathlib, select, shutil, signal, sys, time
assert sys.argv[1:5] == ["-I", "-m", "blender_nep", "cameras"], sys.argv
here, photos = pathlib.Path(__file__).parent, pathlib.Path(sys.argv[5])
(here / "arguments.json").write_text(json.dumps(sys.argv[6:]))
if photos.is_file():  # a video, or a folder with one
    photos = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
    shutil.copytree(here / "photos", photos, ignore=shutil.ignore_patterns("transforms*"), dirs_exist_ok=True)
mode = (here / "mode").read_text() if (here / "mode").exists() else "well"
def say(**event):
    print(json.dumps(event), flush=True)
def fail(code, name, message, hint, **values):
    say(event="error", code=code, name=name, values=values, message=message, hint=hint)
    sys.exit(code)
if mode == "old":
    sys.exit("blender-nep: error: argument {info,reconstruct}: invalid choice: 'cameras' (choose from info, reconstruct)")
note = {"code": "cameras.features", "values": {"step": 3, "steps": 6}, "message": "finding features in photo 3 of 6"}
say(event="progress", stage="finding_cameras", step=3, steps=6, fraction=0.25, eta_s=75, note=note)
while mode == "slow" and not (here / "go").exists():
    if select.select([sys.stdin], [], [], 0.02)[0]:
        (here / "stopped").write_text(sys.stdin.readline() or "closed")
        fail(7, "stopped.cameras", "stopped (stop command)", "Nothing was written.")
if mode == "deaf":
    (here / "waiting").touch()
    time.sleep(600)
if mode == "crash":
    os.kill(os.getpid(), signal.SIGKILL)
if mode == "fail":
    fail(3, "capture.cameras_not_found", "no photo could be placed: the photos share too few points", "A print.", placed=0)
if mode == "locked":
    path = str(photos / "transforms.json")
    fail(5, "output.not_permitted", path + " may not be written", "--out", path=path, reason="Permission denied")
if mode == "improve":
    values = {"before": 0.9, "after": 0.3, "degrees": 0.1, "percent": 0.2}
    say(event="scene", lines=[{"code": "cameras.improved", "values": values}])
    say(event="done", asset=str(photos))
    sys.exit()
if (photos / "transforms.json").exists() and "--overwrite" not in sys.argv:
    fail(2, "usage.cameras_exist", "there are cameras", "--overwrite", folder=str(photos))
found = json.loads((here / "transforms.json").read_text())
names = [frame["file_path"] for frame in found["frames"]]
lines = [{"code": "cameras.placed", "values": {"count": len(names), "photos": len(names), "error": 0.31}}]
if mode == "sure":
    lines.append({"code": "cameras.sure", "values": {}, "message": "the cameras look right"})
else:
    found["frames"].pop()
    lines[0]["values"]["count"] -= 1
    say(event="warning", code="cameras.not_placed", values={"count": 1, "names": names[-1:]}, message="not placed")
(photos / "transforms.json").write_text(json.dumps(found))
say(event="scene", lines=lines)
say(event="done", asset=str(photos))
"""

SIZE = (48, 32)
COUNT = 6


def make(folder: Path) -> str:
    """Write the executable, and the cameras that it finds; returns its path."""
    (folder / "transforms.json").write_text(json.dumps(cameras()))
    return write_executable(folder / "camera-engine-python", SCRIPT)


def cameras() -> dict:
    """Cameras in the form that the engine writes: a lens with distortion, and paths relative to the folder."""
    frames = []
    for number in range(COUNT):
        turn = 2 * np.pi * number / COUNT
        matrix = look_at(np.array([3 * np.cos(turn), 3 * np.sin(turn), 1.0]), np.zeros(3))
        frames.append({"file_path": f"photo_{number}.jpg", "transform_matrix": matrix.tolist()})
    lens = {"fl_x": 50.0, "fl_y": 50.0, "cx": 24.5, "cy": 16.5, "k1": -0.1, "k2": 0.02, "p1": 0.0, "p2": 0.0}
    sphere = {"object_center": [0.0, 0.0, 0.0], "object_radius": 1.0}
    return {"camera_model": "OPENCV", "w": SIZE[0], "h": SIZE[1], **lens, **sphere, "frames": frames}


def write_photos(folder: Path, count: int = COUNT) -> Path:
    """Write photos without cameras, and files that are no photos. Returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        Image.new("RGB", SIZE, (40 * number, 90, 90)).save(folder / f"photo_{number}.jpg")
    (folder / ".hidden.jpg").touch()
    (folder / "notes.txt").touch()
    (folder / "masks.png").mkdir(exist_ok=True)
    return folder
