"""What test_snapshots.py checks in Blender. It imports no torch: that would take seconds."""

import sys

import numpy as np


def invert():
    from backend.synthetic_capture.snapshots import Phone

    phone = Phone(64, 1.1)
    x, y = phone.pinhole_places()
    r2 = x * x + y * y
    factor = 1 + phone.k1 * r2 + phone.k2 * r2 * r2
    place = (np.arange(64) + 0.5 - 32) / phone.focal_length
    assert np.abs(x * factor - place[None]).max() < 1e-9 and np.abs(y * factor - place[:, None]).max() < 1e-9
    flat = np.full((phone.rendered_size,) * 2, 0.7)
    assert np.abs(phone.resampled(flat) - 0.7).max() < 1e-6


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
