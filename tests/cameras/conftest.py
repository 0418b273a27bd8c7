"""Shows at the end what came out of the broken captures (test_broken_photos.py), and keeps searches for cameras short."""

from __future__ import annotations

from typing import Any

import pytest

from blender_nep.cameras.object_sphere import ObjectSphere
from blender_nep.job.commands import camera_search

BROKEN = "broken capture"
"""Name of a test's property: (how a capture is broken, what came out)"""


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the table of all broken captures whose tests have run here."""
    reports = (report for kind in ("passed", "failed") for report in terminalreporter.getreports(kind))
    rows = [value for report in reports if report.when == "call" for name, value in report.user_properties if name == BROKEN]
    if rows:
        width = max(len(case) for case, _ in rows)
        terminalreporter.section("broken captures")
        for case, result in rows:
            terminalreporter.write_line(f"{case:{width}}  {result}")


@pytest.fixture(autouse=True, scope="module")
def no_search_for_the_sphere():
    """The search for the object's sphere takes many seconds. tests/fields/test_object_sphere.py tests it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            camera_search,
            "find_object_sphere",
            lambda capture, lines, check: ObjectSphere(capture.object_center, capture.object_radius, True),
        )
        yield
