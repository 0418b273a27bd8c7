"""What is read of this machine: the free memory of a container, from the files by which Linux tells it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from blender_nep.batch.workers import machine

GB = 1 << 30
VERSION_2 = ("memory.max", "memory.current", "memory.stat", "")
VERSION_1 = ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "memory/memory.stat", "total_")


@pytest.fixture
def container(tmp_path, monkeypatch):
    """Writes the files of a container on a machine with 64 GB of free memory; returns the free memory [GB] in it."""
    monkeypatch.setattr(machine, "_CONTAINER", tmp_path)
    monkeypatch.setattr(machine.psutil, "virtual_memory", lambda: SimpleNamespace(available=64 * GB))

    def free(files, limit: object, taken: float, inactive: float | None = None, active: float = 0.0) -> float:
        for name, text in ((files[0], limit), (files[1], int(taken * GB))):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(f"{text}\n")
        if inactive is not None:
            lines = {"anon": GB, "inactive_file": int(inactive * GB), "active_file": int(active * GB)}
            written = "".join(f"{files[3]}{name} {size}\n" for name, size in lines.items())
            (tmp_path / files[2]).write_text("inactive_file 77\n" * bool(files[3]) + written)
        return machine.free_memory_mb() / 1024 / 0.9

    return free


@pytest.mark.parametrize("files", [VERSION_2, VERSION_1], ids=["version 2", "version 1"])
def test_copies_of_files_are_free_memory(container, files):
    assert container(files, 16 * GB, 15.5, inactive=13, active=1.5) == pytest.approx(15)
    assert container(files, 16 * GB, 15.5, inactive=0) == pytest.approx(0.5)
    assert container(files, 16 * GB, 4, inactive=5) == pytest.approx(16), "never less than nothing is taken"


def test_without_the_parts_all_counts_as_taken(container):
    assert container(VERSION_2, 16 * GB, 15.5) == pytest.approx(0.5)


def test_a_container_without_a_limit_has_what_the_machine_has(container):
    assert container(VERSION_2, "max", 15.5, inactive=3) == pytest.approx(64)
    assert container(VERSION_1, 9223372036854771712, 15.5, inactive=3) == pytest.approx(64)


def test_more_taken_than_allowed_is_nothing_free(container):
    assert container(VERSION_2, 16 * GB, 17) == 0
