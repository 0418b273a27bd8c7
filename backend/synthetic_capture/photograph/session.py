"""A session of photographs: sets up the scene for each photo, and develops what was rendered."""

import json
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...scene_io.image_files import write_whole
from ..files.exif import MAKER, MODEL
from ..files.photo_files import BRIGHTNESS, automatic_gain, film_focal_length, gain_for, write_jpeg
from .daylight import Days
from .development import developed
from .effects import APERTURE, EXPOSURE, NOISE, PHOTOGRAPHER, TWO_DAYS, Stage, develops, draws
from .photographer import Photographer
from .settings import balance_of_day, draw_look, draw_settings

PHOTOGRAPHS = "photographs.json"
"""What was drawn, beside transforms.json"""
SENSOR, FILM = 23.6, 36.0
"""Widths [mm] of the sensor whose depth of field a photo has, and of the film that Blender's lens is for"""
NAMES = {MAKER: "Synthetic", MODEL: "Tone curve"}
"""What EXIF calls a camera that has a tone curve of its own. Real cameras write such names, too."""
FOCUS = 0.4
"""Photos are focused this far before the object's center, in object radii: on its surface"""


class Camera:
    """The person's camera: the settings of each photo, and their development."""

    def __init__(self, effects: frozenset[str], seed: int, photos: int, focal_length: float, brightness: float = BRIGHTNESS):
        """`focal_length` as a part of a photo's width; `brightness`: mean sRGB value that the exposure aims at."""
        self.effects, self.seed, self.brightness = effects, seed, brightness
        self.settings = draw_settings(effects, seed, photos)
        self.look = draw_look(effects, seed)
        self.film_focal_length = film_focal_length(focal_length, 1)
        self.gains: list[float] = []
        """of each day"""
        self.balances: list[tuple[float, float, float]] = []
        """of each day: the gains of the white balance"""

    def meter(self, photos: Sequence[tuple[int, np.ndarray]]) -> None:
        """Find exposure and white balance of each day, on some photos: (their numbers, radiance [H,W,3])."""
        days = [[photo for number, photo in photos if self.settings[number].day == day] for day in (0, 1)]
        self.gains = [gain_for(shown, self.brightness) for shown in days if shown]
        colors = [np.mean([photo.mean((0, 1)) for photo in shown], axis=0) for shown in days if shown]
        self.balances = [balance_of_day(color, colors[0]) for color in colors]

    def take(self, path: Path, radiance: np.ndarray, number: int) -> dict:
        """Write the photo of linear radiance [H,W,3] as JPEG. Returns its settings as plain values. Raises OSError."""
        settings = self.settings[number]
        gain = self.gains[settings.day]
        if EXPOSURE in self.effects:
            gain = automatic_gain(radiance, self.brightness, gain) * 2**settings.stops
        red, green, blue = np.multiply(settings.balance, self.balances[settings.day]).tolist()
        noise = draws(self.seed, NOISE, number) if NOISE in self.effects else None
        photo = developed(radiance, gain, (red, green, blue), self.look, settings.iso, noise)
        tags = settings.tags(gain / self.gains[0], self.film_focal_length) | (NAMES if self.look else {})
        write_jpeg(path, photo, tags)
        return settings.as_json() | {"gain": gain, "balance": (red, green, blue)}


def write_description(folder: Path, camera: Camera, taken: list[dict]) -> None:
    """Write `photographs.json`: the effects, the camera's look, and the settings of the photos. Raises OSError."""
    look = vars(camera.look) if camera.look else None
    values = {"effects": sorted(camera.effects), "seed": camera.seed, "look": look, "photos": taken}
    write_whole(folder / PHOTOGRAPHS, (json.dumps(values, indent=1) + "\n").encode())


class Session:
    """The scene in which photographs are taken, and the camera that takes them."""

    def __init__(self, camera: Camera, stage: Stage):
        self.camera, self.stage = camera, stage
        self.days = Days(stage) if TWO_DAYS in camera.effects else None
        self.photographer = Photographer(stage) if PHOTOGRAPHER in camera.effects else None

    @property
    def develops(self) -> bool:
        """Whether the photos to learn from are JPEG files."""
        return develops(self.camera.effects)

    def set_up(self, camera: bpy.types.Camera, matrix: Matrix, number: int | None) -> None:
        """Prepare the scene for the photo with this number, or for a test view (None), which is clean.

        `matrix` is camera-to-world.
        """
        if self.days:
            self.days.shine(0 if number is None else self.camera.settings[number].day)
        if self.photographer:
            self.photographer.hide() if number is None else self.photographer.stand_behind(matrix)
        depth = camera.dof
        depth.use_dof = APERTURE in self.camera.effects and number is not None
        if depth.use_dof:
            depth.focus_distance = matrix.translation.length - FOCUS
            # Blender takes a unit for a meter.
            depth.aperture_fstop = self.camera.settings[number].f_number / self.stage.meter * FILM / SENSOR
