"""Makes the table of `docs/photographs.md`: what each effect of photographs costs, beside the clean render."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.reports.rows import Figure, Results
from benchmarks.reports.tables import NONE, SCORES
from benchmarks.suite.harness import markdown
from benchmarks.suite.render import CLEAN, photograph_name

COLUMNS = ("cd_visible", "normal_deg", "mask_iou", "background_psnr", "mse_albedo", "mse_roughness", "mse_metallic")
TIMES = frozenset(("cd_visible", "mse_albedo", "mse_roughness", "mse_metallic"))
"""Of COLUMNS, those beside which the table says how many times the clean render's figure this is"""


def photograph_table(rows: Iterable[dict]) -> str:
    """A line for each object, preset and effect of kept rows: the figures, and how many times those of the clean render.

    Captures are named by `photograph_name`; others are left out. A run that failed has its message.
    """
    rows = [row for row in rows if "+" in row["capture"]]
    results, lines = Results(rows), []
    failed = {(row["capture"], row["preset"]): row["error"] for row in rows if "error" in row}
    runs = dict.fromkeys((*row["capture"].rsplit("+", 1), row["preset"]) for row in rows)
    for thing, preset in dict.fromkeys((thing, preset) for thing, _, preset in runs):

        def figures(effect: str, thing: str = thing, preset: str = preset) -> dict[str, Figure | None]:
            own = results.whole(capture=photograph_name(thing, effect), preset=preset, ablation="full")
            return {name: own.figure(name) for name in COLUMNS}

        effects = [effect for other, effect, own in runs if (other, own) == (thing, preset) and effect != CLEAN]
        clean = figures(CLEAN)
        lines.append([thing, preset, CLEAN, *(_cell(name, clean[name]) for name in COLUMNS)])
        for effect in effects:
            lines.append([thing, preset, effect, *(_cell(name, own, clean[name]) for name, own in figures(effect).items())])
        for line in lines[-1 - len(effects) :]:
            line.append(failed.get((photograph_name(thing, line[2]), preset), ""))
    return markdown(["object", "preset", "effect", *(SCORES[name][0] for name in COLUMNS), "failed"], lines)


def _cell(name: str, figure: Figure | None, clean: Figure | None = None) -> str:
    if figure is None:
        return NONE
    text = f"{figure.mean:.{SCORES[name][1]}f}"
    return f"{text} ({figure.mean / clean.mean:.1f} x)" if clean and clean.mean > 0 and name in TIMES else text
