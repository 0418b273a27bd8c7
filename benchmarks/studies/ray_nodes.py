"""A Ray cluster whose nodes are all on this machine. Each node has as many cores as it is told to have."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile

import psutil

from benchmarks.suite.harness import ROOT
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER, isolated_python


class RayNodes:
    """Nodes that `ray start` starts, one after the other. They need the extra `cluster`."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"127.0.0.1:{self._port}"
        self._folder = tempfile.mkdtemp(prefix="ray_", dir="/tmp")  # sockets need a short path
        self._nodes: list[set[psutil.Process]] = []

    def add(self, cores: int, memory_mb: float = 4000) -> None:
        """Start a node with so many cores; the first one is the head."""
        where = [f"--address={self.address}"]
        if not self._nodes:
            where = ["--head", f"--port={self._port}", "--include-dashboard=false", f"--temp-dir={self._folder}"]
        has = [f"--num-cpus={cores}", f"--memory={int(memory_mb * 1e6)}", "--object-store-memory=80000000"]
        has += ["--node-ip-address=127.0.0.1", "--disable-usage-stats"]
        before = self._processes()
        subprocess.run(
            [*isolated_python(), "-m", "ray.scripts.scripts", "start", *where, *has],
            cwd=NEUTRAL_FOLDER,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            check=True,
            timeout=120,
        )
        self._nodes.append(self._processes() - before)

    def _processes(self) -> set[psutil.Process]:
        """All processes of these nodes. The command of each one names the folder."""
        return {one for one in psutil.process_iter(["cmdline"]) if any(self._folder in x for x in one.info["cmdline"] or ())}

    def lose(self, node: int) -> None:
        """Kill a node's processes, and with them all that it has started."""
        raylets = [one for one in self._nodes[node] if one.is_running() and "raylet" in one.name()]
        for one in raylets or self._nodes[node]:
            one.kill()

    def close(self) -> None:
        """Kill all nodes, and remove their folder."""
        for one in self._processes():
            one.kill()
        shutil.rmtree(self._folder, ignore_errors=True)
