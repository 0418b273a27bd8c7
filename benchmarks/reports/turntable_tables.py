"""The table of turntables: an object that turned, the same job without the turns, and a walk around the same object."""

from __future__ import annotations

from benchmarks.reports.rows import Results
from benchmarks.reports.tables import COSTS, SCORES, cells, headings, known, presets_of
from benchmarks.suite.harness import markdown
from benchmarks.suite.plan import TURNTABLE_OFF
from benchmarks.suite.render import TURNED, WALKED

COLUMNS = (
    *("cd_visible", "normal_deg", "mask_iou", "mse_roughness", "mse_metallic", "mse_albedo"),
    *("light_psnr", "light_correlation", "cpu_seconds"),
)
WAYS = {"walk": (WALKED, "full"), "turntable": (TURNED, "full"), "turntable, light turns": (TURNED, TURNTABLE_OFF)}
"""What a line says of the photos -> the ending of the capture's name, and the ablation"""


def turntable_table(results: Results) -> str:
    """A line for each object, way and preset, with means over seeds. An object is a capture's name without its ending."""
    ways = {way: results.whole(ablation=ablation) for way, (_, ablation) in WAYS.items()}
    names = {
        name.removesuffix(ending)
        for name in results.values("capture")
        for ending in (TURNED, WALKED)
        if name.endswith(ending)
    }
    columns = known(results, {name: (SCORES | COSTS)[name] for name in COLUMNS})
    lines = []
    for thing in sorted(names):
        for way, (ending, _) in WAYS.items():
            own = ways[way].where(capture=thing + ending)
            for preset in presets_of(own):
                chosen = own.where(preset=preset)
                lines.append([thing, way, preset, chosen.count, *cells(chosen, columns)])
    return markdown(["object", "photos", "preset", "seeds", *headings(columns)], lines)
