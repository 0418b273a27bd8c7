"""The options of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from blender_nep.safety.isolated_python import isolated_python

ENGINE = (*isolated_python(), "-m", "blender_nep")
"""The program that runs one job; the command and its options follow"""


@dataclass(frozen=True)
class BatchSettings:
    """The options of one batch, as the user gave them (`blender_nep/cli.py`)."""

    captures: tuple[Path, ...]
    """Capture folders, folders that hold captures, and text files with one folder a line. None: those of the last start"""
    out: Path
    preset: str = "balanced"
    masks: str = "use"
    metal: str = "auto"
    turntable: str = "auto"
    all_photos: bool = False
    """Learn also from photos that were taken in another light than most"""
    faces: int | None = None
    """Largest number of faces of the meshes. None: the preset's"""
    seed: int = 0
    device: str = "auto"
    clean: bool = False
    """Remove the checkpoints of finished objects"""
    overwrite: bool = False
    workers: int | None = None
    """Largest number of jobs at once. None: one for each core"""
    threads: int | None = None
    """CPU threads of each job. None: the cores are divided among the jobs"""
    memory_mb: float | None = None
    """What all jobs together may need [MB]. None: what is free now"""
    ray: str | None = None
    """Address of a Ray cluster, or 'auto'. None: this machine"""
    ship: bool = False
    """Send captures and assets through Ray, for nodes that do not share the disk"""
    engine: tuple[str, ...] = ENGINE

    def identity(self) -> dict[str, object]:
        """The options that decide what the assets are. All starts in one folder must agree in them."""
        return {
            "preset": self.preset,
            "masks": self.masks,
            "metal": self.metal,
            "turntable": self.turntable,
            "all_photos": self.all_photos,
            "faces": self.faces,
            "seed": self.seed,
        }

    def arguments(self) -> dict[str, object]:
        """The options that every job gets, `--preset` apart."""
        decisive = {name: value for name, value in self.identity().items() if name != "preset"}
        return decisive | {"device": self.device, "clean": self.clean}
