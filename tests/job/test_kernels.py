"""The kernels that a job has to compile are compiled beside it, and the rehearsal compiles those that jobs need."""

import fcntl
import importlib.util
import json
import os
import subprocess
import sys
from typing import ClassVar

import numpy as np
import pytest

from blender_nep.job import kernels
from blender_nep.ops.rehearsal import KERNELS
from support.paths import ROOT

MODULE = """
from blender_nep.ops.compilation import kernel

@kernel()
def total(values):
    return values.sum()
"""
JOB = """
import io, json, sys
from dataclasses import replace
from pathlib import Path

sys.path[:0] = {paths!r}
from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.ops.rehearsal import rehearse
from blender_nep.stop_request import StopRequest
from support.brief_preset import brief_preset
from support.lit_ball import PRESET

def compiled():
    names = {{}}
    for name, module in list(sys.modules.items()):
        if name.startswith("blender_nep."):
            for own, value in vars(module).items():
                if getattr(value, "signatures", None) and value.py_func.__module__ == name:
                    names[name + "." + own] = [str(one) for one in value.signatures]
    return names

rehearse()
before = compiled()
p = brief_preset(least_explanation_ratio=0.0)
surface = replace(p.surface, grid=64, unwrapped_faces=500, faces=1000)
p = replace(p, surface=surface, material=replace(PRESET, samples=300, most_texels=64, unseen_steps=4, rounds=1))
settings = job.Settings(capture=Path({capture!r}), out=Path({out!r}), preset=p, threads=1)
code = job.run(settings, Events(io.StringIO(), sys.stderr), StopRequest())
print(json.dumps([code, before, compiled()]))
"""


class Helper:
    """Stands for a process that compiles kernels."""

    started: ClassVar[list] = []

    def __init__(self, command, **_options):
        self.command, self.ended = command, 0
        Helper.started.append(self)

    def terminate(self):
        self.ended += 1

    def wait(self):
        self.ended += 1


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """A kernel that is not on the disk. Processes beside the job are `Helper.started`."""
    monkeypatch.setattr(kernels.subprocess, "Popen", Helper)
    monkeypatch.setattr(Helper, "started", [])
    (tmp_path / "sums.py").write_text(MODULE)
    spec = importlib.util.spec_from_file_location("sums", tmp_path / "sums.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.total


@pytest.mark.parametrize(("threads", "helpers"), [(1, 0), (2, 1), (3, 2), (16, 3)])
def test_a_job_that_compiles_gets_help_of_other_cores(kernel, threads, helpers):
    with kernels.compiled_beside(threads):
        assert not Helper.started
        for values in (np.ones(2), np.ones(2, np.float32)):
            assert kernel(values) == 2
        parts = [helper.command[-2:] for helper in Helper.started]
        assert parts == [[str(part), str(helpers)] for part in range(helpers)]
    assert [helper.ended for helper in Helper.started] == [2] * helpers


def test_a_job_that_finds_its_kernels_starts_no_process(kernel):
    kernel(np.ones(2))
    with kernels.compiled_beside(4):
        kernel(np.ones(2))
    assert not Helper.started


def test_only_one_job_of_a_machine_is_helped_at_a_time(kernel):
    lock = os.open(os.path.join(kernel.stats.cache_path, "rehearsal.lock"), os.O_RDWR | os.O_CREAT)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with kernels.compiled_beside(4):
        kernel(np.ones(2))
    os.close(lock)
    assert not Helper.started


@pytest.mark.slow
def test_the_rehearsal_compiles_what_a_job_calls(make_capture, tmp_path):
    """With the same types. Otherwise a job would compile a kernel once more."""
    capture = make_capture(masks=True)
    paths = [str(ROOT), str(ROOT / "tests")]
    program = JOB.format(paths=paths, capture=str(capture.folder), out=str(tmp_path / "asset"))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    code, before, after = json.loads(done.stdout.splitlines()[-1])
    assert code == 0 and len(before) >= len(KERNELS)
    assert {name: after[name] for name in before} == before
    assert set(after) - set(before) == {"blender_nep.geometry.uv_raster._rasterize"}
