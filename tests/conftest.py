"""The fixtures that tests of many folders share."""

from __future__ import annotations

import functools
import os
from pathlib import Path


def _one_core_a_worker() -> None:
    """Give each of pytest-xdist's workers a core of its own.

    Jobs and kernels take all cores that they may use; two workers would else wait for each other's threads. Numba still
    gets four threads, so that a test which asks for four has them.
    """
    os.environ.setdefault("NUMBA_NUM_THREADS", "4")
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})


_one_core_a_worker()  # before torch and numba, which count the cores when they are imported

import blender_nep  # noqa: E402, F401  # isort: skip  # before torch: it sets how OpenMP threads wait
import numba  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from PIL import Image  # noqa: E402
from xdist.scheduler import LoadScopeScheduling  # noqa: E402

numba.set_num_threads(min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1, 4))

from support import cpu_costs  # noqa: E402
from support.captures import CENTER, RADIUS, TinyCapture, look_at, write_exr  # noqa: E402


@pytest.fixture
def make_capture(tmp_path):
    """make_capture(views, size, suffix, masks, alpha, bounds) -> TinyCapture, already written."""

    def make(views=6, size=24, suffix=".exr", masks=False, alpha=False, bounds=True, ball=0.5, name="capture"):
        folder = tmp_path / name
        (folder / "images").mkdir(parents=True)
        (folder / "masks").mkdir()
        focal = 1.2 * size
        meta = {"w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2, "frames": []}
        if bounds:
            meta |= {"object_center": CENTER.tolist(), "object_radius": RADIUS}
        y, x = np.mgrid[:size, :size] + 0.5
        for i in range(views):
            turn, rise = 2.4 * i, 0.9 * np.sin(1.7 * i)
            position = CENTER + 2.5 * np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
            matrix = look_at(position, CENTER)
            local = np.stack([(x - size / 2) / focal, -(y - size / 2) / focal, -np.ones_like(x)], -1)
            direction = local @ matrix[:3, :3].T
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            along = ((CENTER - position) * direction).sum(-1)
            covered = np.linalg.norm(position + along[..., None] * direction - CENTER, axis=-1) < ball
            photo = np.where(covered[..., None], 0.4, 0.2 + 0.1 * direction).astype(np.float32)
            coverage = covered.astype(np.float32)
            frame = {"file_path": f"images/{i:03d}{suffix}", "transform_matrix": matrix.tolist()}
            if alpha:
                photo = np.concatenate([photo * coverage[..., None], coverage[..., None]], -1)
            if suffix == ".exr":
                write_exr(folder / frame["file_path"], photo)
            else:
                Image.fromarray(np.round(255 * photo).astype(np.uint8)).save(folder / frame["file_path"])
            if masks:
                frame["mask_path"] = f"masks/{i:03d}.png"
                Image.fromarray(np.round(255 * coverage).astype(np.uint8)).save(folder / frame["mask_path"])
            meta["frames"].append(frame)
        tiny = TinyCapture(folder, meta)
        tiny.save()
        return tiny

    return make


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu-costs", metavar="FILE", help="write the CPU seconds of every test to FILE")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--cpu-costs"):
        cpu_costs.measure(config)


class SharedFixturesScheduling(LoadScopeScheduling):
    """Tests of a file with module fixtures run in one worker, which makes each fixture once. All others run anywhere."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return file if _has_module_fixtures(self.config.rootpath / file) else nodeid


@functools.cache
def _has_module_fixtures(file: Path) -> bool:
    return 'scope="module"' in file.read_text(encoding="utf-8")


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> SharedFixturesScheduling:
    """What pytest-xdist asks for. Its own `loadgroup` has no effect with pytest 9.2, which ignores an item's `_nodeid`."""
    return SharedFixturesScheduling(config, log)
