"""Predicts what a job needs: memory and seconds. Finished objects of the same batch correct the predictions.

docs/batch.md has the measurements behind the figures.
"""

from __future__ import annotations

from dataclasses import dataclass

from blender_nep.batch.captures import Size
from blender_nep.presets import Preset

_BASE_MB = {"preview": 1350.0, "balanced": 2150.0, "quality": 3400.0}
"""Memory of a job that hardly depends on its photos: libraries, kernels, fields, optimizers, samples. These are the largest
peaks of jobs on 30 to 119 photos; 97 jobs were measured with preview and balanced, 9 with quality."""
_CARD_MB = 1300.0
"""What a job with CUDA needs more of the memory of the CPU, for CUDA's libraries and context. Four jobs were measured:
490 to 1,120 MB more than without CUDA, on the same machine."""
_BYTES_A_PIXEL = 20.0
"""Memory of a pixel that a job keeps: color, flags, and the sets of pixels"""
_READING_MB, _BYTES_A_DECODED_PIXEL = 600.0, 14.0
"""Memory while photos are read: libraries, and the float32 copies of the photos that are decoded at once"""
_DECODED_AT_ONCE = 50_000_000
"""Pixels. So many photos are decoded at once as have this many pixels together, but at least one."""
_CAMERAS_MB = 2200.0
"""Memory of the search for cameras: its process and pycolmap's, which sees photos of at most 1600 pixels a side"""
_CAMERAS_SECONDS = 8.4
"""Seconds that the search for cameras takes for a photo: the first guess of `job.commands.camera_search`"""
_MARGIN, _MARGIN_OF_FINISHED = 1.1, 1.2
"""Factors by which a promise is larger than the prediction, and larger than the largest peak of finished objects"""
_SURE = 8
"""As many finished objects may make the promises smaller. Fewer can only make them larger."""
_ONE_THREAD = 1.3
"""A preset's seconds are for two cores. A job with one thread took 1.3 times as long (117 s instead of 93)."""


@dataclass
class Needs:
    """Predictions for the jobs of one preset."""

    preset: Preset
    on_card: bool = False
    """Whether the jobs use a graphics card"""
    _largest_ratio: float = 0.0
    """Largest measured peak / prediction of the finished objects. It is not found anew each time, because the time left of a
    batch asks for the memory of each of 10,000 objects."""
    _measured: int = 0
    """Finished objects whose peak is known"""
    _seconds: float = 0.0
    _expected: float = 0.0

    def memory_mb(self, size: Size | dict[str, int] | None, photos_alone: bool) -> float:
        """What a job may need at most [MB], with a margin. It is promised to the job before it starts."""
        return self._factor() * self._predicted_mb(size, photos_alone)

    def _factor(self) -> float:
        finished = _MARGIN_OF_FINISHED * self._largest_ratio
        return finished if self._measured >= _SURE else max(finished, _MARGIN)

    def _predicted_mb(self, size: Size | dict[str, int] | None, photos_alone: bool) -> float:
        photos, pixels = _counts(size)
        base = _BASE_MB[self.preset.name] + (_CARD_MB if self.on_card else 0.0)
        kept = min(pixels, photos * self.preset.max_pixels_per_photo, self.preset.pixels_in_memory)
        decoded = max(min(_DECODED_AT_ONCE, pixels), pixels / max(photos, 1))
        working = base + _BYTES_A_PIXEL * kept / 1e6
        reading = _READING_MB + (_BYTES_A_PIXEL * kept + _BYTES_A_DECODED_PIXEL * decoded) / 1e6
        return max(working, reading, _CAMERAS_MB if photos_alone else 0.0)

    def seconds(self, size: Size | dict[str, int] | None, photos_alone: bool) -> float:
        """How long a job takes with one thread: a guess, by what finished objects took."""
        pace = self._seconds / self._expected if self._expected else 1.0
        return pace * self._guessed_seconds(size, photos_alone)

    def _guessed_seconds(self, size: Size | dict[str, int] | None, photos_alone: bool) -> float:
        photos, pixels = _counts(size)
        learning = self.preset.fields_seconds + self.preset.surface_seconds + self.preset.material_seconds
        reading = 0.02e-6 * pixels  # 0.5 s for a photo of 24 megapixels (docs/scaling.md)
        return _ONE_THREAD * learning + reading + (_CAMERAS_SECONDS * photos if photos_alone else 0.0)

    def learn(self, size: dict[str, int] | None, photos_alone: bool, peak_mb: float, seconds: float) -> None:
        """Note what a finished object has needed."""
        if peak_mb > 0:
            self._largest_ratio = max(self._largest_ratio, peak_mb / self._predicted_mb(size, photos_alone))
            self._measured += 1
        self._seconds += seconds
        self._expected += self._guessed_seconds(size, photos_alone)


def _counts(size: Size | dict[str, int] | None) -> tuple[int, int]:
    """Photos and pixels; those of an ordinary capture where they are not known."""
    if size is None:
        return 60, 60 * 250_000
    return (size.photos, size.pixels) if isinstance(size, Size) else (size["photos"], size["pixels"])


def threads_for(cores: int, at_once: int, left: int) -> int:
    """CPU threads of a job, if `at_once` jobs may run at once and `left` are running or still to be run.

    All get the same share of the cores.
    """
    return max(1, cores // max(1, min(at_once, left)))
