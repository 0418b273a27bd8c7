"""Runs the engine that redoes an asset's materials with corrections (`blender_nep materials`). No bpy in this file."""

from collections.abc import Mapping
from pathlib import Path

from ..command import materials_arguments
from ..words import CORRECTION_HINTS
from .short_command import CommandError, ShortCommand


class CorrectionError(CommandError):
    """The materials could not be corrected."""

    hints = CORRECTION_HINTS


class CorrectionProcess(ShortCommand):
    """An engine that corrects materials.

    There is no way to stop it: it needs seconds, and an asset of which only some textures are corrected helps nobody. So it
    goes on to its end also when this program ends.
    """

    error_type = CorrectionError
    retry = "Press Apply again."
    outdated = "The installed engine is older than this add-on, and cannot correct materials."

    def __init__(self, python: str, asset: Path, corrections: Mapping[int, Mapping[str, float]]):
        """Start the engine. Raises NoEngineError where it cannot be started."""
        super().__init__(python, materials_arguments(asset, corrections), keep_going=True)
