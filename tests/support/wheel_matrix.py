"""Says which dependencies of the engine have a wheel, for each system and Python: `make wheels`. It needs the package index.

    python tests/support/wheel_matrix.py

For Python 3.11, every dependency of pyproject.toml is looked for in the version of constraints.txt, which is for that
Python. For later ones it is looked for in any version that pyproject.toml allows. A dependency whose environment marker
leaves a system out is not looked for there. The exit code is 1 if a wheel is missing.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib

from packaging.requirements import Requirement
from paths import ROOT

PYTHONS, PINNED = ("3.11", "3.13"), "3.11"
SYSTEMS = {
    "Linux x86-64": ("linux", "x86_64", [f"manylinux_2_{n}_x86_64" for n in (28, 27, 24, 17)] + ["manylinux2014_x86_64"]),
    "Linux arm64": ("linux", "aarch64", [f"manylinux_2_{n}_aarch64" for n in (28, 27, 24, 17)] + ["manylinux2014_aarch64"]),
    "Windows x86-64": ("win32", "AMD64", ["win_amd64"]),
    "macOS arm64": ("darwin", "arm64", ["macosx_14_0_arm64"]),
    "macOS x86-64": ("darwin", "x86_64", ["macosx_14_0_x86_64"]),
}
"""Name -> (sys_platform, platform_machine, tags of the wheels, the newest first)."""
LIMIT_S = 120


def dependencies() -> list[tuple[Requirement, str]]:
    """The engine's dependencies, each with its version in constraints.txt."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        wanted = [Requirement(text) for text in tomllib.load(file)["project"]["dependencies"]]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    versions = {normalized(pin.name): pin.specifier for pin in pins}
    return [(requirement, str(versions[normalized(requirement.name)])) for requirement in wanted]


def normalized(name: str) -> str:
    return name.lower().replace("_", "-")


def has_wheel(wanted: str, tags: list[str], python: str) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--no-deps", "--only-binary=:all:"]
        command += ["--target", folder, "--python-version", python]
        command += [word for tag in tags for word in ("--platform", tag)]
        return subprocess.run([*command, wanted], capture_output=True, timeout=LIMIT_S).returncode == 0


def main() -> int:
    missing = 0
    print("| package | " + " | ".join(SYSTEMS) + " |\n" + "|---" * (1 + len(SYSTEMS)) + "|")
    for requirement, pin in dependencies():
        cells, name = [], requirement.name
        for system, machine, tags in SYSTEMS.values():
            surroundings = {"sys_platform": system, "platform_machine": machine}
            if requirement.marker is not None and not requirement.marker.evaluate(surroundings):
                cells.append("left out")
                continue
            asked = {python: f"{name}{pin if python == PINNED else requirement.specifier}" for python in PYTHONS}
            lacking = [python for python in PYTHONS if not has_wheel(asked[python], tags, python)]
            missing += len(lacking)
            cells.append("no: " + ", ".join(lacking) if lacking else "yes")
        print(f"| {name} {pin} | " + " | ".join(cells) + " |", flush=True)
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
