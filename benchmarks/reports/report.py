"""Fills `docs/benchmarks.md` from the rows of a suite.

The text between the markers of the document is replaced. The rest of the document stays as it is. Markers look like this:

<!-- presets -->  ...  <!-- end of presets -->
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

from benchmarks.reports import tables
from benchmarks.reports.rows import Results
from blender_nep.files import write_text

MARKED = r"(<!-- {0} -->\n).*?(<!-- end of {0} -->)"


def head(rows: list[dict]) -> str:
    """The head of the report: the number of runs, their dates and commits, the machines, the versions of libraries."""

    def each(part: str, key: str) -> str:
        """All different values of `key` in the part `part` of the rows, sorted."""
        return ", ".join(sorted({str(row[part][key]) for row in rows if key in row.get(part, {})}))

    commits = sorted({commit for row in rows for commit in commits_of(row)})
    days = sorted(row["machine"]["date"] for row in rows if "machine" in row)
    versions = [row["learn"]["versions"] for row in rows if "versions" in row.get("learn", {})]
    found = {name: sorted({v[name] for v in versions if name in v}) for v in versions[:1] for name in v}
    return "\n".join(
        [
            f"- {len(rows)} runs, {' to '.join(dict.fromkeys([days[0], days[-1]])) if days else 'no date'}, of "
            f"commit{'s' if len(commits) > 1 else ''} {', '.join(commits) or 'unknown'}",
            f"- {each('machine', 'system')}, {each('machine', 'processor')}, {each('machine', 'cores')} cores, "
            f"{each('machine', 'memory_gb')} GB; "
            f"device {each('learn', 'device')}, {each('learn', 'threads')} thread(s) a run",
            "- " + ", ".join(f"{name} {' and '.join(values)}" for name, values in found.items()),
        ]
    )


def commits_of(row: dict) -> set[str]:
    """The commits of a row's steps, with 7 digits as everywhere in the documents, and "-dirty" where they have that.

    Older rows know only the commit of the step `learn`, as a part of the machine.
    """
    found = {*row.get("commits", {}).values(), row.get("machine", {}).get("commit", "")}
    return {re.sub(r"^([0-9a-f]{7})[0-9a-f]*", r"\1", commit) for commit in found if commit}


TABLES: dict[str, Callable[[Results], str]] = {
    "table 1": tables.table_1,
    "presets": tables.presets,
    "costs": tables.costs,
    "ablations": tables.ablations,
    "ablations by capture": tables.ablations_by_capture,
    "ablations on true meshes": lambda results: tables.ablations(results, "true"),
    "views": lambda results: tables.swept(results, "views", "photos"),
    "pixels": lambda results: tables.swept(results, "pixels", "pixels of a photo"),
    "roughness": tables.roughness,
}
"""Marker -> the function that makes its Markdown table."""
PICTURES = {
    "views": "Error against number of photos",
    "pixels": "Error against image size",
    "roughness": "Error against roughness",
}
"""Marker -> what the plot above its table shows. Markers without a plot are not here."""


def write_report(rows: list[dict], results: Results, document: Path) -> list[str]:
    """Write all tables between the markers of the document. Returns the names of the markers that it does not have."""
    parts = {"head": head(rows), "failures": tables.failed(rows)}
    for name, table in TABLES.items():
        parts[name] = table(results)
        if len(parts[name].splitlines()) == 2:
            parts[name] = "Not run."
        elif name in PICTURES:
            parts[name] = f"![{PICTURES[name]}]({document.stem}/{name}.png)\n\n{parts[name]}"
    return fill(document, parts)


def require_markers(parser: argparse.ArgumentParser, document: Path | None, *names: str) -> None:
    """End the command with the parser's error where `document` is no file, or lacks a marker. None is no document to fill.

    A command asks this before its hours of work.
    """
    if document is None:
        return
    if not document.is_file():
        parser.error(f"{document} is no file: give a document with the markers {', '.join(names)}")
    text = document.read_text(encoding="utf-8")
    for name in names:
        if not re.search(MARKED.format(re.escape(name)), text, re.DOTALL):
            parser.error(f"{document} has no marker {name!r}")


def fill(document: Path, parts: dict[str, str]) -> list[str]:
    """Write each Markdown text of `parts` {marker: text} between the document's markers of that name.

    Returns the names of the markers that the document does not have. Raises OutputError where it cannot be written, and it
    then stays as it is.
    """
    text, missing = document.read_text(encoding="utf-8"), []
    for name, part in parts.items():
        marked = re.compile(MARKED.format(re.escape(name)), re.DOTALL)
        if not marked.search(text):
            missing.append(name)
        text = marked.sub(lambda found, part=part: f"{found[1]}{part}\n{found[2]}", text)
    write_text(document.resolve(), text)  # a link stays a link
    return missing
