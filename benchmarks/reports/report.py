"""Fills tables of documents from kept rows.

The text between the markers of a document is replaced. The rest of the document stays as it is. A marker names the sources
of its rows (`benchmarks/suite/kept_rows.py`), so that anyone can make the table again:

<!-- presets from 25ca25c+a950af3 b7a687f -->  ...  <!-- end of presets -->

A marker without sources holds text that something else has written, or that is older than the kept rows.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.reports import photograph_tables, random_tables, tables, turntable_tables
from benchmarks.reports.rows import Results
from benchmarks.suite.kept_rows import ROWS, chosen, lasting
from blender_nep.files import write_text

MARKED = r"<!-- ({0})((?: from [^>]*?)?) -->\n.*?(<!-- end of {0} -->)"


def head(rows: list[dict]) -> str:
    """The head of the report: the number of runs, their dates and commits, the machines, the versions of libraries."""

    def each(part: str, key: str) -> str:
        """All different values of `key` in the part `part` of the rows, sorted."""
        return ", ".join(sorted({str(row[part][key]) for row in rows if key in row.get(part, {})}))

    commits = sorted({commit for row in rows for commit in (row["commit"], *row.get("commits", {}).values()) if commit})
    days = sorted(row["date"] for row in rows if row.get("date"))
    versions = [row["versions"] for row in rows if "versions" in row]
    found = {name: sorted({v[name] for v in versions if name in v}) for v in versions[:1] for name in v}
    runs = sum(row.get("seeds", 1) for row in rows)
    return "\n".join(
        [
            f"- {runs} runs, {' to '.join(dict.fromkeys([days[0], days[-1]])) if days else 'no date'}, of "
            f"commit{'s' if len(commits) > 1 else ''} {', '.join(commits) or 'unknown'}",
            f"- {each('machine', 'system')}, {each('machine', 'processor')}, {each('machine', 'cores')} cores, "
            f"{each('machine', 'memory_gb')} GB; "
            f"device {each('machine', 'device')}, {each('machine', 'threads')} thread(s) a run",
            "- " + ", ".join(f"{name} {' and '.join(values)}" for name, values in found.items()),
        ]
    )


def _of_results(table: Callable[[Results], str]) -> Callable[[list[dict]], str]:
    return lambda rows: table(Results(rows))


TABLES: dict[str, Callable[[list[dict]], str]] = {
    "head": head,
    "summary": _of_results(tables.summary),
    "table 1": _of_results(tables.table_1),
    "presets": _of_results(tables.presets),
    "costs": _of_results(tables.costs),
    "ablations": _of_results(tables.ablations),
    "ablations by capture": _of_results(tables.ablations_by_capture),
    "ablations on true meshes": lambda rows: tables.ablations(Results(rows), "true"),
    "views": lambda rows: tables.swept(Results(rows), "views", "photos"),
    "pixels": lambda rows: tables.swept(Results(rows), "pixels", "pixels of a photo"),
    "roughness": _of_results(tables.roughness),
    "failures": tables.failed,
    "history": tables.history,
    "means": lambda rows: random_tables.mean_table(random_tables.scenes_of(rows)),
    **{
        marker: lambda rows, marker=marker: random_tables.scene_table(
            random_tables.part_of(random_tables.scenes_of(rows), marker)
        )
        for marker in random_tables.SETS
    },
    "history of random scenes": random_tables.history,
    "turntables": _of_results(turntable_tables.turntable_table),
    "photographs": photograph_tables.photograph_table,
}
"""Marker -> the function that makes its Markdown text of kept rows."""
HISTORIES = ("history", "history of random scenes")
"""Markers whose tables have lines of many commits. New sources are added to those that they name."""
PICTURES = {
    "views": "Error against number of photos",
    "pixels": "Error against image size",
    "roughness": "Error against roughness",
}
"""Marker -> what the plot above its table shows. Markers without such a plot are not here."""


def sources_of(document: Path) -> dict[str, list[str]]:
    """{marker: the words that name its sources} of the document's markers that TABLES knows, in their order."""
    text = document.read_text(encoding="utf-8")
    found = re.finditer(r"<!-- ([^>]*?)((?: from [^>]*?)?) -->\n.*?<!-- end of \1 -->", text, re.DOTALL)
    return {one[1]: one[2].removeprefix(" from ").split() for one in found if one[1] in TABLES}


def write_report(document: Path, sources: Sequence[str] = (), folder: Path = ROWS) -> dict[str, list[dict]]:
    """Write the tables of a document between its markers. Returns the kept rows that each marker was filled from.

    Each marker is filled from its own sources. `sources` take the place of these for every marker whose table has a line
    then, and are added to those of HISTORIES. The other markers stay as they are. `folder` holds the kept rows.
    Raises SourceError where a source has none.
    """
    parts, used, named = {}, {}, {}
    for marker, own in sources_of(document).items():
        words = list(sources) or own
        if marker in HISTORIES and sources:
            words = ["+".join([*own, *(word for word in sources if word not in own)])]
        if not words:
            continue
        words = ["+".join(dict.fromkeys(lasting(word, folder).split("+"))) for word in words]
        rows = chosen(words, folder)
        text = TABLES[marker](rows)
        if len(text.splitlines()) == 2 and marker != "head":
            continue  # a header without lines
        if marker in PICTURES:
            text = f"![{PICTURES[marker]}]({document.stem}/{marker}.png)\n\n{text}"
        parts[marker], used[marker], named[marker] = text, rows, " from " + " ".join(words)
    fill(document, parts, named)
    return used


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


def fill(document: Path, parts: dict[str, str], sources: dict[str, str] | None = None) -> list[str]:
    """Write each Markdown text of `parts` {marker: text} between the document's markers of that name.

    `sources` {marker: " from ..."} takes the place of what the marker says of its sources; without it, that is taken away.
    Returns the names of the markers that the document does not have. Raises OutputError where it cannot be written, and it
    then stays as it is.
    """
    text, missing = document.read_text(encoding="utf-8"), []
    for name, part in parts.items():
        marked = re.compile(MARKED.format(re.escape(name)), re.DOTALL)
        if not marked.search(text):
            missing.append(name)
        named = (sources or {}).get(name, "")
        text = marked.sub(lambda found, part=part, named=named: f"<!-- {found[1]}{named} -->\n{part}\n{found[3]}", text)
    write_text(document.resolve(), text)  # a link stays a link
    return missing
