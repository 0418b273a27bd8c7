"""The memory that a photo takes while it is opened and read."""

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
import tifffile
from PIL import Image

from blender_nep.capture.photos.photo_files import open_image
from support.icc import DISPLAY_P3, SRGB_CURVE, rgb_profile

MEASURE = """
import sys
from pathlib import Path
from blender_nep.capture.photos.photo_files import open_image

def memory(name):
    status = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in status if line.startswith(name))

def reset_peak():
    Path("/proc/self/clear_refs").write_text("5")

for name in sys.argv[2:]:
    open_image(Path(sys.argv[1], "small", name), "srgb").rows()
    reset_peak()
    before = memory("VmRSS")
    raster = open_image(Path(sys.argv[1], "large", name), "srgb")
    opened = memory("VmHWM") - before
    reset_peak()
    for start in range(0, raster.size[0], 32):
        raster.rows(start, start + 32)
    print(name, opened / raster.stored.nbytes, (memory("VmHWM") - before) / raster.stored.nbytes)
    del raster
"""
"""For each name it prints the largest memory while a photo was opened, and while it was read, in units of its stored pixels.

The peak is reset, because a process begins with its parent's.
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux can reset a peak of memory")
def test_memory_of_a_photo_of_6_megapixels(tmp_path):
    """Opening takes less than four times the memory of the stored pixels; reading in strips takes little besides them."""
    names = ["a.jpg", "a.webp", "a.tif", "a.heic"]
    photo = np.broadcast_to(np.linspace(0, 255, 3000)[None, :, None], (2000, 3000, 3)).astype(np.uint8)
    for folder, pixels in (("large", photo), ("small", photo[:16, :16])):
        (tmp_path / folder).mkdir()
        for name in names:
            write_usual(tmp_path / folder / name, pixels)
    command = [sys.executable, "-c", MEASURE, str(tmp_path), *names]
    # Without this, the allocator keeps the freed memory of a photo, and that of the next photo does not show.
    variables = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
    told = subprocess.run(command, capture_output=True, text=True, check=True, env=variables).stdout
    rows = [line.split() for line in told.splitlines()]
    assert [name for name, _, _ in rows] == names
    for name, opened, read in rows:
        limit = 6.5 if name == "a.webp" else 4  # Pillow decodes WebP as an animation, through pictures with alpha
        assert float(opened) < limit and float(read) < 2, told


def write_usual(path, pixels):
    """Write pixels [H, W, 3] uint8 as cameras and programs do: compressed; TIFF with 16 bits, others with a profile."""
    image = Image.fromarray(pixels)
    if path.suffix == ".tif":
        tifffile.imwrite(path, pixels.astype(np.uint16), photometric="rgb", compression="lzw", rowsperstrip=64)
    elif path.suffix == ".heic":
        pillow_heif.from_pillow(image).save(path, quality=50, enc_params={"preset": "ultrafast"})
    else:
        fast = {"method": 0} if path.suffix == ".webp" else {}
        image.save(path, quality=80, icc_profile=rgb_profile(DISPLAY_P3, SRGB_CURVE), **fast)


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA"])
def test_pixels_are_not_copied_as_a_whole_beside_pillows(tmp_path, mode):
    """What Pillow itself holds is not traced."""
    size, channels = (1000, 900), max(3, len(mode))
    path = tmp_path / "photo.png"
    Image.new(mode, size).save(path)
    open_image(path, "srgb")  # what is made once, such as tables
    tracemalloc.start()
    try:
        raster = open_image(path, "srgb")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert raster.stored.shape == (900, 1000, channels) and peak < 1.3 * raster.stored.nbytes
