"""Small videos, written by PyAV, whose pixels are known."""

from collections.abc import Iterable
from pathlib import Path

import av
import numpy as np

MATRICES = {"709": (0.2126, 0.0722, 1), "601": (0.299, 0.114, 6), "2020": (0.2627, 0.0593, 9)}
"""Weights of red and blue in the brightness, and H.273's code of the matrix and of the primaries"""


def write_film(path: Path, frames: Iterable[np.ndarray], *, rate: int = 30, prepare=None, **options: str) -> Path:
    """Write gray or RGB frames [h, w(, 3)] uint8 as H.264. `prepare` is called with the stream; `options`: the encoder's."""
    with av.open(str(path), "w", options={"movflags": "faststart"} if path.suffix == ".mp4" else {}) as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.options = {"preset": "ultrafast", "crf": "10", **options}
        stream.codec_context.thread_count = 1
        for number, pixels in enumerate(frames):
            if not number:
                stream.height, stream.width = pixels.shape[:2]
                stream.pix_fmt = "yuv420p"
                if prepare is not None:
                    prepare(stream)
            frame = av.VideoFrame.from_ndarray(pixels, format="gray" if pixels.ndim == 2 else "rgb24")
            container.mux(stream.encode(frame.reformat(format="yuv420p")))
        container.mux(stream.encode())
    return path


def write_color(
    path: Path, rgb: tuple[float, ...], matrix: str, *, full: bool, bits: int, told: bool = True, transfer: int = 13
) -> Path:
    """Write three frames of one color, R'G'B' in 0..1, by the formulas of BT.601, BT.709 and BT.2020. Lossless.

    `full`: the range of the values. `told`: whether the file names matrix, range, primaries and the code `transfer`.
    """
    red, blue, code = MATRICES[matrix]
    luma = red * rgb[0] + (1 - red - blue) * rgb[1] + blue * rgb[2]
    planes = [luma, (rgb[2] - luma) / (2 * (1 - blue)), (rgb[0] - luma) / (2 * (1 - red))]
    scale, top = 1 << (bits - 8), (1 << bits) - 1
    if full:
        values = [planes[0] * top, *(value * top + 128 * scale for value in planes[1:])]
    else:
        values = [scale * (16 + 219 * planes[0]), *(scale * (128 + 224 * value) for value in planes[1:])]
    kind, layout = (np.uint8, "yuv420p") if bits == 8 else (np.uint16, "yuv420p10le")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt, stream.options = 96, 64, layout, {"crf": "0", "preset": "ultrafast"}
        context = stream.codec_context
        if told:
            context.colorspace = context.color_primaries = code
            context.color_range, context.color_trc = (2 if full else 1), transfer
        for _ in range(3):
            frame = av.VideoFrame(96, 64, layout)
            for plane, value in zip(frame.planes, values, strict=True):
                np.frombuffer(memoryview(plane), kind)[:] = round(value)
            if told:
                frame.colorspace, frame.color_range = context.colorspace, context.color_range
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def texture(height: int, width: int, seed: int = 0) -> np.ndarray:
    """A picture [height, width] uint8 with contrast of all sizes."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width))
    for size in (4, 8, 16, 32):
        cells = rng.normal(size=(height // size + 2, width // size + 2))
        total += np.kron(cells, np.ones((size, size)))[:height, :width] + 0.3 * rng.normal(size=(height, width)) / size
    return np.clip(128 + 30 * total, 0, 255).astype(np.uint8)


def pan(places: Iterable[float], height: int = 96, width: int = 128, seed: int = 0) -> list[np.ndarray]:
    """Frames [height, width] uint8 of a camera that moves over a texture, each one at its place in pixels."""
    places = list(places)
    wide = texture(height, width + int(max(places)) + 2, seed).astype(float)
    frames = []
    for place in places:
        whole, part = int(place), place - int(place)
        frames.append((1 - part) * wide[:, whole : whole + width] + part * wide[:, whole + 1 : whole + 1 + width])
    return [frame.astype(np.uint8) for frame in frames]
