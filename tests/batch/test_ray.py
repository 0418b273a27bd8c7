"""A batch on a Ray cluster of two nodes, which are both on this machine. Skipped where ray is not installed."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path

import pytest

from benchmarks.studies.ray_nodes import RayNodes
from blender_nep.batch.workers.machine import jobs_in
from support.traps import set_traps
from support.waiting import wait_until

pytest.importorskip("ray", reason="ray is not installed: it is only in the extra `cluster`, and 200 MB large")
pytestmark = pytest.mark.slow

WHOLE = ["0", "1", "2", "3"]


@pytest.fixture
def cluster():
    made = RayNodes()
    try:
        made.add(cores=1)
        yield made
    finally:
        made.close()


def test_a_lost_node_costs_no_object(batch, cluster):
    cluster.add(cores=1)
    for name in ("a", "b", "c"):
        batch.add(name, "slow")
    batch.add("d", "refuse")
    options = {"ray": cluster.address, "workers": None, "memory_mb": None}
    thread = threading.Thread(target=batch.run, kwargs=options)
    thread.start()
    waiting = [batch.out / name / "waiting" for name in ("a", "b", "c")]
    try:
        wait_until(lambda: sum(path.exists() for path in waiting) == 2)
        cluster.lose(1)
        wait_until(lambda: len(jobs_in(batch.out)) == 1)
        most = 0
        for _ in range(30):  # Ray gives the cores of a task to others while the task waits for something
            most = max(most, len(jobs_in(batch.out)))
            time.sleep(0.2)
    finally:  # else a failure would wait for the batch for ever
        for name in ("a", "b", "c"):
            (batch.captures / name / "go").touch()
        thread.join()
    assert most == 1, "the node that is left has one core"
    found = batch.objects()
    assert {name: one["state"] for name, one in found.items()} == {"a": "done", "b": "done", "c": "done", "d": "failed"}
    assert all(batch.steps(name) == WHOLE for name in ("a", "b", "c"))
    assert sum(one["attempts"] for one in found.values()) == 5, "one of the three was started again"
    assert ":" in found["a"]["worker"]


def test_captures_assets_and_checkpoints_can_be_sent(batch, cluster):
    """The first attempt is killed. Its checkpoint comes back here, and is sent to the second one."""
    meta = batch.add("a") / "transforms.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"plays": "crash 1"}))  # of a capture, only its files are sent
    code, events = batch.run(ray=cluster.address, ship=True, memory_mb=None)
    assert code == 0, events[-1]
    assert batch.steps("a") == WHOLE and batch.objects()["a"]["attempts"] == 2
    command = json.loads((batch.out / "a/arguments.json").read_text())
    there, out = Path(command[1]), Path(command[command.index("--out") + 1])
    assert there != batch.captures / "a" and not there.exists(), "it has worked on a copy"
    assert os.path.relpath(there, out) == os.path.relpath(batch.captures / "a", batch.out / "a")


def test_a_node_runs_nothing_from_the_current_folder(batch, cluster, tmp_path, monkeypatch):
    """Ray lets its processes import from the folder in which it was joined. That folder may hold files of strangers."""
    sprung = set_traps(tmp_path / "stranger", "blender_nep")
    monkeypatch.chdir(sprung.parent)
    batch.add("a")
    code, events = batch.run(ray=cluster.address, memory_mb=None)
    assert not sprung.exists()
    assert code == 0 and Path.cwd() == sprung.parent, events[-1]


def test_no_cluster_is_told(batch):
    batch.add("a")
    code, events = batch.run(ray="127.0.0.1:1")
    assert code == 2 and events[-1]["name"] == "usage.no_ray"
