"""Pixels in a file have the values of pixels in memory. Pixel sets, stored as runs, hold the indices of plain tensors."""

import errno
import io
import json
import os
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import Capture, PixelRays, load_capture
from blender_nep.capture.photos.photo_files import open_image
from blender_nep.capture.rays import decoded_photos, pixel_rays
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.capture.rays.pixel_store import FileStore, PixelMemory
from blender_nep.errors import OutputError
from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.messages import Message
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.98, 1.0])
def test_a_pixel_set_is_the_tensor_of_its_indices(share):
    generator = torch.Generator().manual_seed(3)
    flags = torch.rand(5000, generator=generator) < share
    plain = flags.nonzero()[:, 0] + 70
    pixels = PixelSet.where(flags, 70)
    assert len(pixels) == len(plain) and torch.equal(pixels.tensor(), plain) and torch.equal(pixels[:], plain)
    if len(plain):
        some = torch.randint(len(plain), (300,), generator=generator)
        assert torch.equal(pixels[some], plain[some]) and torch.equal(pixels[3:900:7], plain[3:900:7])
        assert torch.equal(torch.cat(list(pixels.split(64))), plain)
        assert torch.equal(pixels[plain % 3 == 0], plain[plain % 3 == 0])
    shuffled = plain[torch.randperm(len(plain), generator=generator)]
    assert torch.equal(PixelSet.of(shuffled).tensor(), shuffled)
    assert torch.equal(PixelSet.from_state(PixelSet.joined([pixels, pixels]).state()).tensor(), plain.repeat(2))


@pytest.mark.parametrize("masks", [False, True])
def test_pixels_in_a_file_are_those_in_memory_in_half_precision(make_capture, tmp_path, masks):
    capture = load_capture(make_capture(views=5, masks=True).folder)
    kept = PixelRays.from_capture(capture, 200, masks)
    folder = tmp_path / "asset"
    filed = PixelRays.from_capture(capture, 200, masks, memory=PixelMemory(in_memory=10, folder=folder))
    assert filed.radiance.dtype == torch.float16 and torch.equal(filed.radiance, kept.radiance.half())
    assert torch.equal(filed.valid, kept.valid) and (filed.mask is None) == (not masks)
    assert not masks or torch.equal(filed.mask, kept.mask)
    assert torch.equal(filed.sphere.tensor(), kept.sphere.tensor())
    assert torch.equal(filed.outside.tensor(), kept.outside.tensor())
    assert list(folder.iterdir()) == [], "the file has no name: nothing is left behind, however the process ends"


def test_a_full_disk_is_the_documented_error(tmp_path, monkeypatch):
    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tempfile.TemporaryFile", lambda **_: Full())
    store = FileStore(4, (3,), np.float16, tmp_path)
    with pytest.raises(OutputError, match="disk is full"):
        store.append(np.zeros((2, 3), np.float32))


def test_a_budget_for_all_photos_filters_each_down_and_says_so(make_capture):
    capture = load_capture(make_capture(views=6, size=24).folder)
    rays = PixelRays.from_capture(capture, 24 * 24, False, memory=PixelMemory(most=6 * 12 * 12))
    assert rays.size == [(12, 12)] * 6
    assert rays.warnings[0] == Message("capture.photos_reduced", {"photos": 6, "pixels": 144, "limit": 6 * 144})


@pytest.mark.parametrize(("suffix", "alpha"), [(".exr", False), (".exr", True), (".png", False)])
def test_strips_give_what_the_whole_photo_gives(make_capture, monkeypatch, suffix, alpha):
    tiny = make_capture(views=4, size=31, suffix=suffix, alpha=alpha)
    capture = load_capture(tiny.folder)
    whole = PixelRays.from_capture(capture, 100, True)
    for module in (decoded_photos, pixel_rays):
        monkeypatch.setattr(module, "STRIP_PIXELS", 1)
    strips = PixelRays.from_capture(capture, 100, True)
    assert whole.size == strips.size == [(7, 7)] * 4
    assert torch.equal(whole.radiance, strips.radiance) and torch.equal(whole.valid, strips.valid)
    assert (whole.mask is None) == (not alpha) and (not alpha or torch.equal(whole.mask, strips.mask))
    # and the box filter is a mean of what the file holds, where nothing is cut out
    color, _ = open_image(capture.views[0].image_path, capture.color_space).rows()
    expected = color[:28, :28].reshape(7, 4, 7, 4, 3).astype(np.float64).mean((1, 3)).reshape(-1, 3)
    if not alpha:
        np.testing.assert_allclose(strips.radiance[:49], expected, rtol=1e-5)
    raster = open_image(capture.views[0].image_path, capture.color_space)
    np.testing.assert_array_equal(np.concatenate([raster.rows(k, k + 4)[0] for k in range(0, 31, 4)]), color)


@pytest.mark.parametrize(("most_pixels", "at_once"), [(24 * 24 - 1, 1), (2 * 24 * 24, 2)])
def test_no_more_photos_are_decoded_at_once_than_memory_allows(make_capture, monkeypatch, most_pixels, at_once):
    capture = load_capture(make_capture(views=8).folder)
    running, most, lock = 0, 0, threading.Lock()
    open_photo = Capture.open_photo

    def counting(*arguments):
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.05)  # long enough that another thread, if there is one, comes in
        try:
            return open_photo(*arguments)
        finally:
            with lock:
                running -= 1

    monkeypatch.setattr(Capture, "open_photo", counting)
    monkeypatch.setattr(decoded_photos, "_DECODED_PIXELS", most_pixels)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
    assert PixelRays.from_capture(capture, 100, False).views == 8 and most == at_once


def test_a_job_reports_the_photos_read_and_stops_between_two(make_capture, tmp_path, monkeypatch):
    capture, out, stop = make_capture(views=6).folder, tmp_path / "asset", StopRequest()
    read, open_photo = 0, Capture.open_photo

    def opening(*arguments):
        nonlocal read
        read += 1
        if read == 4:
            stop.request("test")
        return open_photo(*arguments)

    monkeypatch.setattr(Capture, "open_photo", opening)
    monkeypatch.setattr(decoded_photos, "_DECODED_PIXELS", 1)
    protocol = io.StringIO()
    settings = job.Settings(capture, out, preset("preview"))
    assert job.run(settings, Events(protocol, None, clock=iter(range(1000)).__next__), stop) == 7
    events = [json.loads(line) for line in protocol.getvalue().splitlines()]
    assert "while the photos were read" in events[-1]["message"]
    counted = [(e["step"], e["steps"]) for e in events if e["event"] == "progress"]
    assert counted[0] == (0, 1) and 1 <= len(counted[1:]) < 6 and all(steps == 6 for _, steps in counted[1:])


def test_a_job_with_pixels_in_a_file_leaves_an_asset_and_no_file(make_capture, tmp_path):
    out = tmp_path / "asset"
    settings = job.Settings(make_capture().folder, out, replace(preset("preview"), pixels_in_memory=10))
    kinds = []

    class Stages(BallStages):
        def learn_fields(self, given, *how):
            kinds.append(given.scene.rays.radiance.dtype)
            return super().learn_fields(given, *how)

    assert job.run(settings, Events(None, None), StopRequest(), Stages()) == 0
    assert kinds == [torch.float16] and (out / "report.json").exists()
    assert not [p for p in out.iterdir() if p.name.startswith(".")]
