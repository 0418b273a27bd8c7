"""The docs name files that are there."""

import re
import subprocess
from pathlib import Path

from support.paths import ROOT

FOLDERS = ("", "blender_nep/", "backend/", "addon/", "tests/", "benchmarks/")
"""A path in the docs is relative to the checkout, or to one of these folders."""
EXAMPLES = {"addon/translations.py"}
"""Files that a reader is told to make."""


def documents() -> list[Path]:
    names = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    return [ROOT / name for name in names] or sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def test_every_file_that_a_document_names_is_there():
    missing = []
    for document in documents():
        text = document.read_text(encoding="utf-8")
        named = set(re.findall(r"`([\w./-]+/[\w-]+\.(?:py|md|toml|png))", text)) - EXAMPLES
        missing += [
            (document.name, name) for name in named if not any((ROOT / folder / name).is_file() for folder in FOLDERS)
        ]
        linked = {link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link}
        missing += [(document.name, link) for link in linked if link and not (document.parent / link).exists()]
    assert not missing


def test_readme_is_short_and_has_both_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 1000
    assert "    make demo " in text and "    make test " in text


def test_lab_pages_begin_with_their_answer():
    pages = [page for page in (ROOT / "docs" / "lab").glob("*.md") if page.name != "README.md"]
    without = [
        page.name for page in pages if not page.read_text(encoding="utf-8").splitlines()[2].startswith("**Answer.** ")
    ]
    assert pages and not without
