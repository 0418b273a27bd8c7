"""An executable that plays the engine's Python; the variable SCRIPTED_ENGINE says what it does.

asset: copies the folder SCRIPTED_ASSET to the output folder. refuse: reports an error of the capture. crash: kills itself.
wait: waits for the request to stop, and then writes OUT/checkpoint. deaf: does not react to any request. The last two
write OUT/waiting when they have begun to wait.
"""

from pathlib import Path

from support.executable import write_executable

SCRIPT = """
import json, os, pathlib, shutil, signal, sys, time
assert sys.argv[1:4] == ["-I", "-m", "blender_nep"], sys.argv
assert not [name for name in os.environ if name.startswith(("PYTHON", "BLENDER_"))], dict(os.environ)
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
def say(**event):
    print(json.dumps(event), flush=True)
def wait_for_stop():
    while line := sys.stdin.readline():
        if json.loads(line)["cmd"] == "stop":
            break
    (out / "checkpoint").write_text("saved")
    say(event="error", code=7, message="stopped; checkpoint written", hint="resume")
    sys.exit(7)
out.mkdir(parents=True, exist_ok=True)
(out / "arguments.json").write_text(json.dumps(sys.argv[4:]))
print("a stray line that is no JSON")
say(event="progress", stage="fields_learning", step=1, steps=2, fraction=0.5, eta_s=3, loss=0.1)
mode = os.environ["SCRIPTED_ENGINE"]
if mode == "asset":
    shutil.copytree(os.environ["SCRIPTED_ASSET"], out, dirs_exist_ok=True)
    say(event="done", asset=str(out))
elif mode == "refuse":
    say(event="error", code=3, message="image 004.png is missing", hint="Put it back.")
    sys.exit(3)
elif mode == "crash":
    print("the last words", file=sys.stderr, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
elif mode == "wait":
    (out / "waiting").touch()
    wait_for_stop()
elif mode == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    (out / "waiting").touch()
    time.sleep(600)
"""


def make(folder: Path) -> str:
    """Write the executable; returns its path."""
    return write_executable(folder / "scripted-engine-python", SCRIPT)
