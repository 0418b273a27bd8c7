"""Measure how the throughput of a batch grows with the nodes of a Ray cluster that is simulated on this machine.

    python -m benchmarks.studies.cluster [--nodes 1 2 4 8] [--cores 4] [--job-seconds 60] [--jobs-per-core 3]

A stand-in plays every job. It waits, and tells its progress every half second, as a job does. So the study measures what the
batch and Ray add: handing out the tasks, starting Ray's processes, passing on what is heard. It does not measure a job. The
nodes are Ray nodes of their own (`ray start`) with as many cores as they are told to have, all on this machine. The driver's
node has no cores. Ray's processes for the tasks really run here, so a simulated cluster with many cores starts more slowly
than a real one. Needs the extra `cluster`.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
from PIL import Image

from benchmarks.studies.ray_nodes import RayNodes
from benchmarks.suite.harness import markdown, resumed
from blender_nep.batch import runner
from blender_nep.batch.settings import BatchSettings
from blender_nep.job.reporting.events import Events
from blender_nep.safety.isolated_python import isolated_python
from blender_nep.stop_request import StopRequest

STAND_IN = """
import json, pathlib, sys, threading, time
out, seconds = pathlib.Path(sys.argv[sys.argv.index("--out") + 1]), float(sys.argv[1])
out.mkdir(parents=True, exist_ok=True)
begun = time.monotonic()
while (passed := time.monotonic() - begun) < seconds:
    part = {"event": "progress", "stage": "fields_learning", "step": int(passed), "steps": int(seconds), "loss": None}
    print(json.dumps(part | {"fraction": passed / seconds, "eta_s": seconds - passed}), flush=True)
    time.sleep(0.5)
(out / "report.json").write_text(json.dumps({"stages": {}, "materials": [], "peak_memory_mb": 100.0}))
print(json.dumps({"event": "done", "asset": str(out)}), flush=True)
"""
"""The program that plays a job. Its first argument is how many seconds it takes."""


class CpuWatch(threading.Thread):
    """Measures the CPU seconds of this process, which is the batch's driver, and of the batch's mailbox.

    The mailbox is a process of its own. It is looked at once a second, as long as it lives. What this thread itself takes
    for that is not counted.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.driver_seconds = self.mailbox_seconds = self._own_seconds = 0.0
        self._ended = threading.Event()

    def __enter__(self) -> CpuWatch:
        self._start_seconds = time.process_time()
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.join()
        self.driver_seconds = time.process_time() - self._start_seconds - self._own_seconds

    def run(self) -> None:
        """Look for the mailbox until the context ends."""
        try:
            self._watch()
        finally:
            self._own_seconds = time.thread_time()

    def _watch(self) -> None:
        while not self._ended.wait(1.0):
            for one in psutil.process_iter(["cmdline", "cpu_times"]):
                if one.info["cmdline"] and one.info["cmdline"][0].startswith("ray::Mailbox"):
                    self.mailbox_seconds = max(self.mailbox_seconds, sum(one.info["cpu_times"][:2]))  # user and system


def make_captures(folder: Path, count: int) -> None:
    """Write `count` captures of 12 tiny photos. Only the batch's look at captures reads them."""
    eye = np.eye(4)
    eye[2, 3] = 3
    frames = [{"file_path": f"images/{k:03d}.png", "transform_matrix": eye.tolist()} for k in range(12)]
    meta = {"w": 8, "h": 8, "fl_x": 8, "fl_y": 8, "cx": 4, "cy": 4, "object_center": [0, 0, 0], "object_radius": 1}
    for number in range(count):
        capture = folder / f"object_{number:04d}"
        (capture / "images").mkdir(parents=True)
        for frame in frames:
            Image.new("RGB", (8, 8)).save(capture / frame["file_path"])
        (capture / "transforms.json").write_text(json.dumps(meta | {"frames": frames}))


def measure(nodes: int, cores: int, seconds: float, rounds: int) -> dict[str, float]:
    """Run one batch of `rounds` jobs for each core. Returns wall seconds, CPU seconds, and objects an hour."""
    count = nodes * cores * rounds
    cluster = RayNodes()
    try:
        cluster.add(0)
        for _ in range(nodes):
            cluster.add(cores, 1e5)
        with tempfile.TemporaryDirectory(prefix="nep_") as name:
            folder = Path(name)
            make_captures(folder / "captures", count)
            (folder / "stand_in.py").write_text(STAND_IN)
            engine = (*isolated_python(), str(folder / "stand_in.py"), str(seconds))
            settings = BatchSettings(
                (folder / "captures",), folder / "shelf", preset="preview", threads=1, ray=cluster.address, engine=engine
            )
            wall = time.monotonic()
            with CpuWatch() as watch:
                code = runner.run(settings, Events(io.StringIO(), sys.stderr), StopRequest())
            wall = time.monotonic() - wall
            objects = json.loads((folder / "shelf" / "batch.json").read_text())["objects"]
    finally:
        cluster.close()
    done = sum(one["state"] == "done" for one in objects)
    return {
        "code": code,
        "objects": count,
        "done": done,
        "wall_s": wall,
        "per_hour": 3600 * done / wall,
        "driver_cpu_s": watch.driver_seconds,
        "mailbox_cpu_s": watch.mailbox_seconds,
    }


def table(rows: list[dict]) -> str:
    """What was measured, beside the best that this number of cores can do."""
    lines = []
    for row in rows:
        best = row["rounds"] * row["seconds"]
        lines.append(
            [
                f"{row['nodes']} x {row['cores']}",
                f"{row['done']} of {row['objects']}",
                f"{row['wall_s']:.0f}",
                f"{best:.0f}",
                f"{best / row['wall_s']:.0%}",
                f"{row['per_hour']:.0f}",
                f"{row['driver_cpu_s']:.0f} + {row['mailbox_cpu_s']:.0f}",
            ]
        )
    head = ["nodes x cores", "objects", "wall s", "best s", "of the best", "objects an hour", "CPU s of driver + mailbox"]
    return markdown(head, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--nodes", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--cores", type=int, default=4, help="of a node (%(default)s)")
    parser.add_argument("--job-seconds", type=float, default=60, help="that a job takes (%(default)s)")
    parser.add_argument("--jobs-per-core", type=int, default=3, help="(%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/cluster"))
    options = parser.parse_args()
    rows = []
    for nodes in options.nodes:
        sizes = {"nodes": nodes, "cores": options.cores, "seconds": options.job_seconds, "rounds": options.jobs_per_core}
        file = options.out / ("-".join(f"{value:g}" for value in sizes.values()) + ".json")
        rows.append(resumed(file, sizes, lambda sizes=sizes: measure(**sizes)))
        print(rows[-1], flush=True)
    print("\n" + table(rows))


if __name__ == "__main__":
    main()
