"""What the files of photos tell of their exposures, and what counts where the surroundings tell something else.

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

LEAST_AGREEMENT = 0.75
"""Told exposures do not count if the surroundings differ less than this share as much with the gains that fit them best.
Measured (docs/lab/exposure.md): 0.89 to 1.00 where EXIF is right, 0.62 where automatic exposures are not told."""
USUAL_BALANCE = 0.05
"""Usual standard deviation of the logarithms of a camera's white balance within a session."""
USUAL_BALANCE_OF_SESSIONS = 0.2
"""The same between sessions, which have another daylight."""


def exposures_of(capture: Capture, compared: Comparison | None, device: torch.device | str = "cpu") -> Exposures:
    """The exposures of the photos, as they are learned from: what their files tell, or else what the surroundings tell.

    compared: None if the photos share too little of the surroundings.
    """
    told = told_exposures(told_gains(capture), sessions(times_of(capture)), compared, device)
    if told is not None:
        return told
    return Exposures(None) if compared is None else compared.exposures(device)


def told_gains(capture: Capture) -> np.ndarray | None:
    """How much brighter [views] each photo was taken than the average, from time x ISO / f-number^2. None: not all tell.

    The geometric mean is 1. Apertures in EXIF are rounded to a third of a stop, exposure times to some percent.
    """
    told = []
    for view in capture.views:
        exposure = _exposure(view)
        if exposure is None:  # the others need not be asked
            return None
        told.append(exposure)
    log = np.log(np.array(told, np.float64))
    return np.exp(log - log.mean())


def _exposure(view: View) -> float | None:
    """Exposure time x ISO / f-number^2 of a photo. None: its file does not tell all three."""
    seconds, f_number, iso = exif_exposure(view.image_path)
    if seconds is None or f_number is None or iso is None:
        return None
    return seconds * iso / f_number**2


def told_exposures(
    told: np.ndarray | None, session: np.ndarray, compared: Comparison | None, device: torch.device | str
) -> Exposures | None:
    """The exposures that the files tell. None: they do not tell, or the surroundings deny it.

    told [views] is that of `told_gains`, and session [views] that of `sessions`. The surroundings tell the brightness of
    each session, and the white balance. The worse they agree with the files, the less their white balance counts. They deny
    what the files tell where a flash was used, or where a program has changed the photos' brightness.
    """
    if told is None:
        return None
    told = np.log(told)
    if compared is None:
        log = (told - _means(told, session))[:, None].repeat(3, 1)
        return _used(log, Exposures(None), device)
    bright = compared.log.mean(1)
    told = told + _medians(bright - told, session)
    balance = compared.log - bright[:, None]
    if compared.rest(compared.log) < LEAST_AGREEMENT * compared.rest(told[:, None] + balance):
        return None
    log = told[:, None] + _likely_balance(balance, session, doubt=float((bright - told).std()))
    return _used(log - log.mean(0), Exposures(None, vignetting=compared.vignetting), device)


def _used(log: np.ndarray, equal: Exposures, device: torch.device | str) -> Exposures:
    """The exposures with these logarithms [views, 3]; `equal` if they hardly differ."""
    if np.sqrt((log**2).mean()) < LEAST_SPREAD:
        return equal
    return Exposures(torch.from_numpy(np.exp(log).astype(np.float32)).to(device), None, equal.vignetting)


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
