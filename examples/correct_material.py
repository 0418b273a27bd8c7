"""Makes an asset's largest material a metal of roughness 0.3: `python -m examples.correct_material asset/ 0.3`."""

import sys
from pathlib import Path

from blender_nep.job.commands import correction
from blender_nep.job.reporting.events import Events
from blender_nep.materials.corrections import Correction


def make_metal(asset: Path, roughness: float) -> int:
    """Correct the asset in place. Returns an exit code of docs/conventions.md: 0, if all is well.

    Raises UsageError where `asset` holds no finished asset.
    """
    materials = correction.read_report(asset)["materials"]
    largest = max(range(len(materials)), key=lambda number: materials[number]["share"])
    return correction.run(asset, {largest: Correction(metallic=1.0, roughness=roughness)}, Events(human=sys.stderr))


if __name__ == "__main__":
    sys.exit(make_metal(Path(sys.argv[1]), float(sys.argv[2])))
