"""Makes an asset of a capture: `python -m examples.capture_to_asset photos/ asset/`, in the folder of this checkout."""

import sys
from pathlib import Path

from blender_nep.job import runner
from blender_nep.job.reporting.events import Events
from blender_nep.job.settings import Settings
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest


def make_asset(capture: Path, asset: Path) -> int:
    """Make an asset of `capture` in the folder `asset`. Returns an exit code of docs/conventions.md: 0, if all is well."""
    settings = Settings(capture, asset, preset("preview"), seed=0)
    with StopRequest().signals() as stop:  # Ctrl-C writes a checkpoint; the job goes on from it with resume=True
        return runner.run(settings, Events(human=sys.stderr), stop)


if __name__ == "__main__":
    sys.exit(make_asset(Path(sys.argv[1]), Path(sys.argv[2])))
