"""Exposures from EXIF, and what counts where the surroundings tell something else.

EXIF tells how much light the camera took in, and not how bright the scene was. So it compares the photos of one session, and
the surroundings compare the sessions. Within a session it tells more than the surroundings do. These hardly look the same
from all sides: a carpet that is lit by a window is up to half a stop brighter, and less colorful, against the light.
"""

from __future__ import annotations

import numpy as np
import torch

from blender_nep.capture.capture import Capture, View
from blender_nep.capture.exposure.sessions import sessions, times_of
from blender_nep.capture.exposure.surroundings import LEAST_SPREAD, Comparison, Exposures
from blender_nep.capture.photos.exif_exposure import exif_exposure
from blender_nep.capture.rays.vignetting import Vignetting

LEAST_AGREEMENT = 0.75
"""EXIF does not count if the surroundings differ less than this share as much with the gains that fit them best.
Measured (docs/lab/exposure.md): 0.89 to 1.00 where EXIF is right, 0.62 where it lacks automatic exposures."""
USUAL_BALANCE = 0.05
"""Usual standard deviation of the logarithms of a camera's white balance within a session."""
USUAL_BALANCE_OF_SESSIONS = 0.2
"""The same between sessions, which have another daylight."""


def exposures_of(capture: Capture, compared: Comparison | None, device: torch.device | str = "cpu") -> Exposures:
    """The exposures of the photos, as they are learned from: those of EXIF, or else those of the surroundings.

    compared: None if the photos share too little of the surroundings.
    """
    return exposures_by(exif_gains(capture), sessions(times_of(capture)), compared, device)


def exposures_by(
    gains: np.ndarray | None, session: np.ndarray, compared: Comparison | None, device: torch.device | str = "cpu"
) -> Exposures:
    """As `exposures_of`, by EXIF that was read before: `exif_gains`, and the session [views] of each photo (`sessions`)."""
    found = exposures_from_exif(gains, session, compared, device)
    if found is not None:
        return found
    return Exposures(None) if compared is None else compared.exposures(device)


def exif_gains(capture: Capture) -> np.ndarray | None:
    """How much brighter [views] each photo was taken than the average, from time x ISO / f-number^2. None: not all have it.

    The geometric mean is 1. Apertures in EXIF are rounded to a third of a stop, exposure times to some percent.
    """
    exposures = []
    for view in capture.views:
        exposure = _exposure(view)
        if exposure is None:  # the others need not be asked
            return None
        exposures.append(exposure)
    log = np.log(np.array(exposures, np.float64))
    return np.exp(log - log.mean())


def _exposure(view: View) -> float | None:
    """Exposure time x ISO / f-number^2 of a photo. None: its file lacks one of them."""
    seconds, f_number, iso = exif_exposure(view.image_path)
    if seconds is None or f_number is None or iso is None:
        return None
    return seconds * iso / f_number**2


def exposures_from_exif(
    gains: np.ndarray | None, session: np.ndarray, compared: Comparison | None, device: torch.device | str
) -> Exposures | None:
    """The exposures by EXIF. None: the files lack them, or the surroundings deny them.

    gains [views] are `exif_gains`, and session [views] is that of `sessions`. The surroundings tell the brightness of each
    session, and the white balance. The worse they agree with EXIF, the less their white balance counts. They deny EXIF where
    a flash was used, or where a program has changed the photos' brightness.
    """
    if gains is None:
        return None
    gray = np.log(gains)
    if compared is None:
        return _exposures((gray - _means(gray, session))[:, None].repeat(3, 1), None, device)
    if agreement(gains, session, compared) < LEAST_AGREEMENT:
        return None
    bright = compared.log.mean(1)
    gray = gray + _medians(bright - gray, session)
    balance = compared.log - bright[:, None]
    log = gray[:, None] + _likely_balance(balance, session, doubt=float((bright - gray).std()))
    return _exposures(log - log.mean(0), compared.vignetting, device)


def agreement(gains: np.ndarray, session: np.ndarray, compared: Comparison) -> float:
    """How much the surroundings differ with the gains that fit them best, as a share of how much with EXIF's gains [views].

    The surroundings tell the brightness of each session, and the white balance.
    """
    bright, gray = compared.log.mean(1), np.log(gains)
    gray = gray + _medians(bright - gray, session)
    left = compared.rest(gray[:, None] + compared.log - bright[:, None])
    return compared.rest(compared.log) / left if left > 0 else 1.0


def _exposures(log: np.ndarray, vignetting: Vignetting | None, device: torch.device | str) -> Exposures:
    """The exposures with these logarithms [views, 3] of the gains; equal ones if they hardly differ."""
    gain = torch.from_numpy(np.exp(log).astype(np.float32)).to(device) if np.sqrt((log**2).mean()) >= LEAST_SPREAD else None
    return Exposures(gain, vignetting=vignetting)


def _likely_balance(found: np.ndarray, session: np.ndarray, doubt: float) -> np.ndarray:
    """The most likely logarithms [views, 3] of the white balance, if the surroundings tell `found` [views, 3].

    doubt: standard deviation of what the surroundings tell. Errors and white balances count as normal numbers, first for the
    medians of the sessions, then for the photos of each.
    """
    of_session = np.stack([_medians(column, session) for column in found.T], 1)
    photos = np.bincount(session)[session][:, None]
    within = USUAL_BALANCE**2 / (USUAL_BALANCE**2 + doubt**2)
    between = USUAL_BALANCE_OF_SESSIONS**2 / (USUAL_BALANCE_OF_SESSIONS**2 + doubt**2 / photos)
    return within * (found - of_session) + between * of_session


def _means(values: np.ndarray, session: np.ndarray) -> np.ndarray:
    """For each photo the mean of its session's values [views]."""
    return (np.bincount(session, values) / np.bincount(session).clip(1))[session]


def _medians(values: np.ndarray, session: np.ndarray) -> np.ndarray:
    """For each photo the median of its session's values [views]."""
    return np.array([np.median(values[session == number]) for number in range(session.max() + 1)])[session]
