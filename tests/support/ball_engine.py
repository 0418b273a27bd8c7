"""An executable that takes the place of the engine's Python. The engine is real, but its stages are ball_stages.BallStages.

BALL_STEPS and BALL_DELAY (seconds a step) in the environment say how long it takes.
"""

from pathlib import Path

from support.executable import write_executable
from support.paths import ROOT, TESTS

SCRIPT = """
import os, sys, time
assert sys.argv[1:4] == ["-I", "-m", "blender_nep"], sys.argv
assert not [name for name in os.environ if name.startswith(("PYTHON", "BLENDER_"))], dict(os.environ)
sys.path[:0] = [{root!r}, {tests!r}]
import numpy as np
from support.ball_stages import BallStages, ball_surface
from PIL import Image
from blender_nep import cli
from blender_nep.job import runner as job
from blender_nep.checkpoints import Checkpoint

class Stages(BallStages):
    def learn_fields(self, given, *how):
        watch = given.watch
        if watch is not None:
            ball = ball_surface()
            np.savez(watch.path / "preview.npz", vertices=ball.vertices.astype("f"), faces=ball.faces.astype("i"))
            Image.new("RGB", (64, 32), (200, 100, 50)).save(watch.path / "preview.png")
            for name in ("preview.npz", "preview.png"):
                watch.events.preview(watch.path / name)
        return super().learn_fields(given, *how)

delay = float(os.environ.get("BALL_DELAY", 0))
Checkpoint.interval = 0.1
job.Stages = lambda: Stages(int(os.environ.get("BALL_STEPS", 3)), lambda stage, step: time.sleep(delay))
sys.exit(cli.main(sys.argv[4:]))
"""


def make(folder: Path) -> str:
    """Write the executable; returns its path."""
    return write_executable(folder / "engine-python", SCRIPT.format(root=str(ROOT), tests=str(TESTS)))
