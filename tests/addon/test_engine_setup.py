"""The installation of the engine, as the preferences follow it. The installer is played."""

import sys
from pathlib import Path

from support.blender_checks import register
from support.own_process import in_blender
from support.waiting import wait_until

SLOW_CLEANUP = "import sys, time; sys.stdin.readline(); time.sleep(600)"


def test_a_cancelled_installation_has_minutes_to_clean_up(package):
    in_blender(check_cancel, package)


def check_cancel(folder):
    setup = register().tasks.engine_setup
    installation = setup.Installation([sys.executable, "-c", SLOW_CLEANUP], folder / "log")
    installation.cancel()
    for _ in range(1000):  # periods of 0.1 s
        assert not installation.poll()
    for _ in range(setup.CANCEL_GRACE_PERIODS):
        installation.poll()
    wait_until(installation.poll)  # killed
    assert not installation.python


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
