"""How the code lies in folders. That no imports go in circles is a contract of `make lint` (pyproject.toml)."""

from collections import Counter
from pathlib import PurePosixPath

from support.paths import ROOT

MOST_FILES = 14
"""Python files side by side in a folder. More of them get sub-folders."""
CODE = ("blender_nep", "backend", "addon", "benchmarks", "release", "examples")


def test_no_folder_has_too_many_files():
    files = [path.relative_to(ROOT) for folder in CODE for path in (ROOT / folder).rglob("*.py")]
    count = Counter(PurePosixPath(file.parent) for file in files)
    assert set(CODE) <= {folder.parts[0] for folder in count}
    assert {str(folder): n for folder, n in count.items() if n > MOST_FILES} == {}
