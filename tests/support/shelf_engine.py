"""An executable that plays the engine's Python for `blender_nep batch` and `blender_nep gallery`.

It writes its arguments to arguments.json beside itself. The asset of every object is a copy of the folder `asset` beside it;
an object whose capture's name begins with "bad" fails. The file `mode` beside it says what else it does: slow: after the
first object it waits until the file `go` is there, or until it is asked to stop. late: as slow, and it begins when the file
`begin` is there. crash: it kills itself. old: it does not know the command.
"""

from pathlib import Path

from support.executable import write_executable

SCRIPT = """
import fcntl, json, os, pathlib, select, shutil, signal, sys, time
assert sys.argv[1:4] == ["-I", "-m", "blender_nep"], sys.argv
here, command, given = pathlib.Path(__file__).parent, sys.argv[4], sys.argv[5:]
mode = (here / "mode").read_text() if (here / "mode").exists() else "well"
def say(**event):
    print(json.dumps(event), flush=True)
def fail(code, name, message, hint, **values):
    say(event="error", code=code, name=name, values=values, message=message, hint=hint)
    sys.exit(code)
if mode == "old":
    sys.exit("blender-nep: error: argument {info,reconstruct}: invalid choice: '%s' (choose from info)" % command)
if command == "gallery":
    strips = [path.parent.name for path in pathlib.Path(given[0]).glob("*/turntable.png")]
    (pathlib.Path(given[0]) / "index.html").write_text(" ".join(sorted(strips)))
    sys.exit()
(here / "arguments.json").write_text(json.dumps(given))
out = pathlib.Path(given[given.index("--out") + 1])
if mode == "crash":
    os.kill(os.getpid(), signal.SIGKILL)
while mode == "late" and not (here / "begin").exists():
    time.sleep(0.02)
out.mkdir(exist_ok=True)
lock = open(out / "batch.lock", "w")
fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
(out / "batch.stop").unlink(missing_ok=True)
state = out / "batch.json"
captures = [pathlib.Path(path) for path in given[:given.index("--out")]]
objects = json.loads(state.read_text())["objects"] if state.exists() else []
known = [one["capture"] for one in objects]
for path in captures:
    if str(path) not in known:
        objects.append({"name": path.name, "capture": str(path), "photos_alone": False, "state": "waiting", "fraction": 0})
def write():
    content = {"format": 1, "preset": "preview", "started": "2026-11-23T10:00:00+00:00", "objects": objects}
    (out / "partial").write_text(json.dumps(content))
    os.replace(out / "partial", state)
def stopped():
    watched = "--watch-stdin" in given
    return (out / "batch.stop").exists() or (watched and select.select([sys.stdin], [], [], 0)[0])
note = {"code": "batch.progress", "values": {"objects": 2, "done": 0, "running": 1, "waiting": 1, "failed": 0}}
say(event="progress", stage="batch", step=0, steps=2, fraction=0.25, eta_s=75, note=note)
for number, one in enumerate(objects):
    if number and mode in ("slow", "late"):
        one.update(state="running", fraction=0.4, stage="surface")
        write()
        while not (here / "go").exists():
            if stopped():
                one["state"] = "stopped"
                write()
                (here / "stopped").touch()
                fail(7, "stopped.batch", "stopped", "Start it again.", reason="", left=1)
            time.sleep(0.02)
    if one["name"].startswith("bad"):
        told = {"name": "capture", "values": {}, "code": 3, "message": "the photos are no good", "hint": "Take others."}
        one.update(state="failed", error=told)
    elif one["state"] != "done":
        shutil.copytree(here / "asset", out / one["name"], dirs_exist_ok=True)
        one.update(state="done", fraction=1, stage=None)
    write()
failed = [one["name"] for one in objects if one["state"] == "failed"]
if failed:
    fail(9, "objects_failed", "some objects failed", "Again.", names=failed, objects=len(objects))
say(event="done", asset=str(out))
"""


def make(folder: Path) -> str:
    """Write the executable; returns its path. It takes `folder`/asset for every asset."""
    return write_executable(folder / "shelf-engine-python", SCRIPT)
