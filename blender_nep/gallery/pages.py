"""Puts a batch into HTML: the templates, the words and the numbers as people read them."""

from __future__ import annotations

import base64
import hashlib
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from urllib.parse import quote

import jinja2
from markupsafe import Markup

from blender_nep import __version__

TEMPLATES = Path(__file__).with_name("templates")

GROUP_WORDS = {"done": "done", "failed": "failed", "left": "not finished"}
"""{part of index.html: its words}"""
STAGE_WORDS = {
    "capture": "Reading the photos",
    "fields_learning": "Learning shape and light",
    "surface": "Making the mesh",
    "material_learning": "Learning the materials",
    "asset": "Writing the result",
    "finding_cameras": "Finding the cameras",
}
"""{stage: its words}. `STAGES` in backend/engine/progress.py has the same for the sidebar."""


def render(template: str, **values: object) -> str:
    """A page from a template in `templates/`. All values are escaped."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters.update(
        count=lambda number: f"{number:,}",
        href=lambda name: quote(name, safe=""),
        memory=memory,
        moment=moment,
        percent=lambda fraction: f"{100 * fraction:.0f} %",
        share=lambda fraction: f"{100 * fraction:.0f} %" if fraction >= 0.005 else "< 1 %",
        time=duration,
    )
    found.globals.update(
        version=__version__, group_words=GROUP_WORDS, stage_words=STAGE_WORDS, inline=_inline, digest=_digest
    )
    return found


@cache
def _inline(name: str) -> Markup:
    """The text of a style sheet or a script of ours, which goes into the page as it is."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8"))


@cache
def _digest(name: str) -> str:
    """The hash by which the page's Content-Security-Policy allows a script of ours, and no other script."""
    return "sha256-" + base64.b64encode(hashlib.sha256(_inline(name).encode()).digest()).decode()


@cache
def templates_digest() -> str:
    """A hash of all templates, which tells whether a page was made from others."""
    content = b"".join(path.read_bytes() for path in sorted(TEMPLATES.iterdir()) if path.is_file())
    return hashlib.sha256(content).hexdigest()


def duration(seconds: float) -> str:
    """A time in words: `48 s`, `5 min 12 s`, `2 h 5 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def memory(megabytes: float) -> str:
    """An amount of memory in words: `830 MB`, `1.7 GB`."""
    return f"{megabytes:.0f} MB" if megabytes < 1000 else f"{megabytes / 1000:.1f} GB"


def moment(text: str) -> str:
    """An ISO 8601 time as `2026-11-23 10:00 UTC`, or the text itself if it is none."""
    try:
        return f"{datetime.fromisoformat(text).astimezone(UTC):%Y-%m-%d %H:%M} UTC"
    except ValueError:
        return text
