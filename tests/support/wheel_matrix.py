"""Says which dependencies of the engine have a wheel, for each system and Python: `make wheels`. It needs the package index.

    python tests/support/wheel_matrix.py

Every dependency of pyproject.toml is looked for in the version that constraints.txt has for that Python. A dependency whose
environment marker leaves a system out is not looked for there. The exit code is 1 if a wheel is missing.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import tomllib

from packaging.requirements import Requirement
from paths import ROOT

PYTHONS = ("3.11", "3.12", "3.13")
SYSTEMS = {
    "Linux x86-64": ("linux", "x86_64", [f"manylinux_2_{n}_x86_64" for n in (28, 27, 24, 17)] + ["manylinux2014_x86_64"]),
    "Linux arm64": ("linux", "aarch64", [f"manylinux_2_{n}_aarch64" for n in (28, 27, 24, 17)] + ["manylinux2014_aarch64"]),
    "Windows x86-64": ("win32", "AMD64", ["win_amd64"]),
    "macOS arm64": ("darwin", "arm64", ["macosx_14_0_arm64"]),
    "macOS x86-64": ("darwin", "x86_64", ["macosx_14_0_x86_64"]),
}
"""Name -> (sys_platform, platform_machine, tags of the wheels, the newest first)."""
LIMIT_S = 120


def dependencies() -> list[tuple[Requirement, dict[str, str]]]:
    """The engine's dependencies, each with its versions in constraints.txt: {Python: version}."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        wanted = [Requirement(text) for text in tomllib.load(file)["project"]["dependencies"]]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    versions = {
        python: {
            normalized(pin.name): str(pin.specifier)
            for pin in pins
            if pin.marker is None or pin.marker.evaluate({"python_version": python})
        }
        for python in PYTHONS
    }
    names = [normalized(requirement.name) for requirement in wanted]
    return [(one, {python: versions[python][name] for python in PYTHONS}) for one, name in zip(wanted, names, strict=True)]


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
    for requirement, pins in dependencies():
        cells, name = [], requirement.name
        for system, machine, tags in SYSTEMS.values():
            surroundings = {"sys_platform": system, "platform_machine": machine}
            if requirement.marker is not None and not requirement.marker.evaluate(surroundings):
                cells.append("left out")
                continue
            lacking = [python for python in PYTHONS if not has_wheel(f"{name}{pins[python]}", tags, python)]
            missing += len(lacking)
            cells.append("no: " + ", ".join(lacking) if lacking else "yes")
        shown = ", ".join(dict.fromkeys(pins.values()))
        print(f"| {name} {shown} | " + " | ".join(cells) + " |", flush=True)
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
