"""How each photo is taken: day and time, aperture, ISO, exposure, white balance; and what EXIF says of it."""

import math
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from fractions import Fraction

import numpy as np

from ..files.exif import EXPOSURE_TIME, F_NUMBER, FILM_FOCAL_LENGTH, ISO, TAKEN_AT
from .development import Look
from .effects import APERTURE, CURVE, EXPOSURE, NOISE, TWO_DAYS, draws

START, PAUSE, NEXT_DAY = datetime(2026, 5, 2, 10, 5), timedelta(seconds=9), timedelta(hours=35)
"""When the first photo is taken, the time between photos, and from the first photo to the first one of the second day"""
FIRST_DAY = 2 / 3
"""Share of the photos that are taken on the first of two days"""
F_NUMBERS, USUAL_F_NUMBER = (2.8, 14.0), 8.0
ISOS = (100, 200, 400, 800, 1600, 3200, 6400)
STOPS, WHITE_BALANCE = 0.2, 0.03
"""Standard deviations, from photo to photo: of the exposure in stops, beside what the automatic exposure does, and of the
logarithm of the white balance's gains"""
SECONDS = 0.5
"""Exposure time of the base exposure at f/8 and ISO 100, as in a room"""
TIME_UNITS = 10**6
"""EXIF tells the exposure time as a multiple of a second divided by this."""
SHARE_OF_BALANCE = 0.6
"""By which part of its logarithm the white balance evens out the color of another light"""


@dataclass(frozen=True)
class Settings:
    """How one photo is taken."""

    taken_at: datetime
    day: int = 0
    """0, or 1 on the second of two days"""
    f_number: float = USUAL_F_NUMBER
    iso: int = 100
    stops: float = 0.0
    """drift of the exposure"""
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """gains of the white balance for R, G and B, beside those of the day"""

    def tags(self, relative_gain: float, film_focal_length: int) -> dict[int, int | Fraction | str]:
        """The EXIF tags. `relative_gain`: the photo's gain as a multiple of the base exposure's.

        The gain is proportional to time x ISO / f-number^2. The exposure time makes this true, within 0.1 % of times above a
        millisecond.
        """
        seconds = SECONDS * relative_gain * (self.f_number / USUAL_F_NUMBER) ** 2 * 100 / self.iso
        return {
            EXPOSURE_TIME: Fraction(max(1, round(seconds * TIME_UNITS)), TIME_UNITS),
            F_NUMBER: Fraction(round(10 * self.f_number), 10),
            ISO: self.iso,
            TAKEN_AT: self.taken_at.strftime("%Y:%m:%d %H:%M:%S"),
            FILM_FOCAL_LENGTH: film_focal_length,
        }

    def as_json(self) -> dict:
        """The settings as plain values."""
        return asdict(self) | {"taken_at": self.taken_at.isoformat()}


def first_day(effects: frozenset[str], photos: int) -> int:
    """How many of the photos are taken on the first day."""
    return math.ceil(FIRST_DAY * photos) if TWO_DAYS in effects else photos


def draw_settings(effects: frozenset[str], seed: int, photos: int) -> list[Settings]:
    """The settings of each photo of a capture, in the order in which they are taken."""
    first, drawn = first_day(effects, photos), []
    for number in range(photos):
        day = int(number >= first)
        settings = Settings(START + day * NEXT_DAY + (number - day * first) * PAUSE, day)
        if APERTURE in effects:
            low, high = np.log(F_NUMBERS)
            f_number = math.exp(draws(seed, APERTURE, number).uniform(low, high))
            settings = replace(settings, f_number=min(max(round(f_number, 1), F_NUMBERS[0]), F_NUMBERS[1]))
        if NOISE in effects:
            settings = replace(settings, iso=int(draws(seed, NOISE, number).choice(ISOS)))
        if EXPOSURE in effects:
            rng = draws(seed, EXPOSURE, number)
            red, blue = np.exp(rng.normal(0, WHITE_BALANCE, 2)).tolist()
            settings = replace(settings, stops=float(rng.normal(0, STOPS)), balance=(red, 1.0, blue))
        drawn.append(settings)
    return drawn


def draw_look(effects: frozenset[str], seed: int) -> Look | None:
    """The taste of the capture's camera; None without the effect `curve`."""
    if CURVE not in effects:
        return None
    rng = draws(seed, CURVE)
    limits = {
        "lift": (0.85, 0.95),
        "contrast": (1.15, 1.4),
        "saturation": (1.1, 1.3),
        "local_contrast": (0.1, 0.3),
        "sharpening": (0.4, 0.9),
    }
    return Look(**{name: float(rng.uniform(*limit)) for name, limit in limits.items()})


def balance_of_day(color: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """The gains of the white balance where photos have the mean color `color` [3], and `reference` [3] on the first day."""
    cast = (np.asarray(color) / color[1]) / (np.asarray(reference) / reference[1])
    red, green, blue = (cast**-SHARE_OF_BALANCE).tolist()
    return red, green, blue
