"""A program that plays `blender-nep reconstruct` and `cameras` for tests of a batch, in milliseconds.

What it does stands in the file `plays` in the capture, or under the key `plays` of transforms.json. Without these it makes
an asset.

    refuse      reports an error of the capture
    crash N     kills itself at step 2 of the first N attempts
    short N     reports that memory is short in the first N attempts
    slow        makes its steps only when the file `go` is in the capture, and stops with a checkpoint when it is asked to
    deaf        waits, and does not listen to anything

If OUT/checkpoints/run.json has a key `refused`, it reports the error whose name is its value. `cameras` hands the file
`plays` on to the capture that it makes.

Each step adds a line to OUT/steps.txt, and is counted in OUT/checkpoints/fields_learning.pt: nothing should be done twice.
"""

from __future__ import annotations

import sys
from pathlib import Path

SCRIPT = """
import json, os, pathlib, signal, sys, threading, time
command, capture = sys.argv[1], pathlib.Path(sys.argv[2])
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir(parents=True, exist_ok=True)
plays = capture / "plays"
if plays.exists():
    mode, *rest = plays.read_text().split()
else:
    meta = json.loads((capture / "transforms.json").read_text()) if (capture / "transforms.json").exists() else {}
    mode, *rest = meta.get("plays", "well").split()
tries = out / "tries"
attempt = int(tries.read_text()) if tries.exists() else 0
tries.write_text(str(attempt + 1))
first = mode in ("crash", "short") and attempt < int(rest[0])
stopped = threading.Event()
def listen():
    while (line := os.read(0, 4096)) and b"stop" not in line:
        pass
    stopped.set()
if mode != "deaf":
    threading.Thread(target=listen, daemon=True).start()
def say(**event):
    print(json.dumps(event), flush=True)
def fail(code, name, message):
    say(event="error", code=code, name=name, values={}, message=message, hint="do something")
    sys.exit(code)
if command == "cameras":
    (out / "transforms.json").write_text(json.dumps({"written_by": "blender_nep", "frames": []}))
    if plays.exists():
        (out / "plays").write_text(plays.read_text())
    say(event="done", asset=str(out))
    sys.exit()
assert "--resume" in sys.argv and "--watch-stdin" in sys.argv, sys.argv
(out / "arguments.json").write_text(json.dumps(sys.argv[1:]))
run = out / "checkpoints/run.json"
refused = json.loads(run.read_text()).get("refused") if run.exists() else None
if refused:
    fail(2, refused, "cannot resume")
if (out / "report.json").exists():
    sys.exit("an asset that is complete was started again")
if mode == "refuse":
    fail(3, "capture", "the photos are no good")
if mode == "short" and first:
    fail(1, "unexpected.no_memory", "out of memory")
run.parent.mkdir(exist_ok=True)
run.write_text(json.dumps({"format": 1, "capture": "", "preset": "", "seed": 0}))
checkpoint = out / "checkpoints/fields_learning.pt"
done = int(checkpoint.read_text()) if checkpoint.exists() else 0
if mode in ("slow", "deaf"):
    say(event="progress", stage="fields_learning", step=done, steps=4, fraction=done / 4, eta_s=300, loss=None)
    (out / "waiting").touch()
    while not (capture / "go").exists() and not stopped.wait(0.01):
        pass
say(event="warning", code="capture.few_photos", values={"photos": 6}, message="only 6 photos")
for step in range(done, 4):
    say(event="progress", stage="fields_learning", step=step, steps=4, fraction=step / 4, eta_s=1, loss=None)
    if stopped.is_set():
        fail(7, "stopped", "stopped; the checkpoint is written")
    if mode == "crash" and first and step == 2:
        print("last words", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    with open(out / "steps.txt", "a") as steps:
        steps.write(f"{step}\\n")
    checkpoint.write_text(str(step + 1))
report = {"stages": {"surface": {"faces": 80}}, "materials": [{}, {}], "peak_memory_mb": 300.0}
report["device"] = os.environ.get("NEP_PLAYED_DEVICE", "cpu")
(out / "report.json").write_text(json.dumps(report))
say(event="done", asset=str(out))
"""


def make(folder: Path) -> tuple[str, ...]:
    """Write the program; returns the command that starts it."""
    path = folder / "batch_engine.py"
    path.write_text(SCRIPT)
    return sys.executable, str(path)
