"""Where things are in this checkout."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
SUZANNE_SMALL = ROOT / "data" / "suzanne_small"
"""The small capture that is kept in the repository."""
CHEAP_CYCLES = TESTS / "support" / "cheap_cycles.py"
"""The script that runs what renders, with cheaper pictures."""
