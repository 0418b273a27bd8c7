"""Draws the plots of `docs/benchmarks/`. This file needs the extra `bench` (matplotlib)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt

from benchmarks.reports.rows import Results
from benchmarks.reports.tables import golds, learned_from, main_captures, presets_of, sweeps
from blender_nep.files import write_atomically

ERRORS = {
    "cd_visible": "distance, object radii",
    "normal_deg": "error of normals, degrees",
    "mse_roughness": "MSE of roughness",
    "mse_metallic": "MSE of metallic",
    "mse_albedo": "MSE of albedo",
    "psnr_mean": "relit, dB",
}
MARKS = {"preview": "v", "balanced": "o", "quality": "^"}


def _scored(results: Results) -> list[str]:
    """The scores that any run has. Without scores there is nothing to draw."""
    return [name for name in ERRORS if results.figure(name)]


def _figure(results: Results, title: str) -> tuple[plt.Figure, dict[str, plt.Axes]]:
    """A figure with a panel for each score that any run has. There must be such a score."""
    names = _scored(results)
    figure, panels = plt.subplots(1, len(names), figsize=(3.1 * len(names), 3.1), layout="constrained", squeeze=False)
    figure.suptitle(title, fontsize=10)
    panels = dict(zip(names, panels[0], strict=True))
    for name, panel in panels.items():
        panel.set_title(ERRORS[name], fontsize=8)
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.3)
        panel.set_xlabel("", fontsize=8)
    return figure, panels


def _save(figure: plt.Figure, panels: dict[str, plt.Axes], label: str, file: Path) -> None:
    for panel in panels.values():
        panel.set_xlabel(label, fontsize=8)
        if panel.get_title() != ERRORS["psnr_mean"]:
            panel.set_ylim(bottom=0)
    _legend_and_file(figure, panels.values(), file)


def _legend_and_file(figure: plt.Figure, panels: Iterable[plt.Axes], file: Path) -> None:
    handles = {text: line for panel in panels for line, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, fontsize=7)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, lambda part: figure.savefig(part, format="png", dpi=90, metadata={"Software": None}))
    plt.close(figure)


def _log_axis(panels: dict[str, plt.Axes], ticks: Sequence[float]) -> None:
    """Make the x axis of all panels logarithmic, with the values `ticks` marked."""
    for panel in panels.values():
        panel.set_xscale("log")
        panel.set_xticks(ticks, [f"{tick:.0f}" for tick in ticks], fontsize=7)
        panel.set_xticks([], minor=True)


def _curves(
    panels: dict[str, plt.Axes],
    captures: Sequence[str],
    points: Sequence[tuple[object, Results]],
    suffix: str = "",
    x_of: Callable[[object, Results], float] | None = None,
    color: int = 0,
) -> None:
    """Draw a thin curve for each capture, and a thick one for the mean over the points that all captures have."""
    for name, panel in panels.items():
        lines = []
        for number, capture in enumerate(captures):
            at = {value: chosen.where(capture=capture) for value, chosen in points}
            line = {value: (x_of(value, one), f.mean, f.deviation) for value, one in at.items() if (f := one.figure(name))}
            if line:
                lines.append(line)
                x, y, spread = zip(*line.values(), strict=True)
                panel.errorbar(
                    x, y, spread, color=f"C{number + color}", lw=1, ms=3, marker=".", alpha=0.8, label=capture + suffix
                )
        shared = [value for value, _ in points if all(value in line for line in lines)]
        if len(lines) > 1 and shared:
            x, y = ([sum(line[value][axis] for line in lines) / len(lines) for value in shared] for axis in (0, 1))
            panel.plot(x, y, color="black", lw=2, label=f"mean{suffix}")
            for value, *place in zip(shared, x, y, strict=True):
                panel.plot(*place, MARKS.get(value, "."), color="black", ms=7)


def error_against_time(results: Results, file: Path) -> None:
    """Draw the errors against the time of a job. A preset is a point of the curve.

    No file is written where no run without ablation is scored.
    """
    full = results.whole(ablation="full")
    captures = main_captures(results)
    full = full.where(capture=captures.__contains__)
    if not _scored(full):
        return
    points = [(preset, full.where(preset=preset)) for preset in presets_of(full)]
    figure, panels = _figure(full, "Error against run time: preview (v), balanced (o), quality (^)")
    _curves(panels, captures, points, x_of=lambda _, at: at.figure("cpu_seconds").mean)
    _log_axis(panels, [at.figure("cpu_seconds").mean for _, at in points])
    _save(figure, panels, "CPU seconds of the whole job (mean)", file)


def error_against_sweep(results: Results, key: str, file: Path) -> None:
    """Draw the errors against the number of photos (`key` is "views"), or against the pixels of a photo ("pixels").

    No file is written where no scored run varies that number.
    """
    label = {"views": "photos", "pixels": "pixels of a photo"}[key]
    found = sweeps(results, key)
    if not found:
        return
    # Only the runs on all photos and pixels are relit, and one point is no curve. So the panels are those of the other runs.
    bounded = found[0][2].where(**{key: lambda value: value is not None})
    if not _scored(bounded):
        return
    figure, panels = _figure(bounded, f"Error against {label}")
    ticks = {}
    for place, (preset, values, chosen) in enumerate(found):
        size = {value: learned_from(chosen, key, value) for value in values}
        ticks |= {round(x): None for x in size.values()}
        _curves(
            panels,
            chosen.values("capture"),
            [(value, chosen.where(**{key: value})) for value in values],
            f", {preset}" if len(found) > 1 else "",
            lambda value, _, size=size: size[value],
            4 * place,
        )
    _log_axis(panels, sorted(ticks))
    _save(figure, panels, label, file)


def error_against_roughness(results: Results, file: Path) -> None:
    """Draw the errors on the captures gold_R against their roughness R. No file is written where none is scored."""
    found = golds(results)
    if not found or not _scored(found[0][2]):
        return
    figure, panels = _figure(found[0][2], "Error against the true roughness of a gold Suzanne")
    for name, panel in panels.items():
        for number, (preset, captures, chosen) in enumerate(found):
            line = [(float(c[5:]), f.mean) for c in captures if (f := chosen.where(capture=c).figure(name))]
            if line:
                panel.plot(*zip(*line, strict=True), color=f"C{number}", marker=MARKS[preset], ms=4, label=preset)
    _save(figure, panels, "true roughness", file)


def time_against_size(results: Results, file: Path) -> None:
    """Draw the seconds of the surface stage against faces, and those of the asset stage against texels.

    No file is written where no run tells them.
    """
    full = results.whole()
    if not (full.figure("faces") and full.figure("cpu_seconds_surface")):
        return
    figure, axes = plt.subplots(1, 2, figsize=(7, 3.1), layout="constrained")
    pairs = (
        ("faces", "cpu_seconds_surface", "surface stage, CPU seconds against faces"),
        ("texels", "cpu_seconds_asset", "asset stage, CPU seconds against texels of a texture"),
    )
    for panel, (size, seconds, title) in zip(axes, pairs, strict=True):
        for number, preset in enumerate(presets_of(full)):
            each = [values.means for _, values in full.where(preset=preset).runs]
            found = [(v[size], v[seconds]) for v in each if size in v and seconds in v]
            if found:
                panel.plot(*zip(*found, strict=True), MARKS[preset], color=f"C{number}", ms=4, alpha=0.6, label=preset)
        panel.set(xscale="log", yscale="log")
        panel.set_title(title, fontsize=8)
        panel.tick_params(labelsize=7, which="both")
        panel.grid(alpha=0.3)
    _legend_and_file(figure, axes, file)


PLOTS: dict[str, tuple[str, Callable[[Results, Path], None]]] = {
    "time": ("presets", error_against_time),
    "views": ("views", lambda results, file: error_against_sweep(results, "views", file)),
    "pixels": ("pixels", lambda results, file: error_against_sweep(results, "pixels", file)),
    "roughness": ("roughness", error_against_roughness),
    "size": ("costs", time_against_size),
}
"""File name without ending -> (the table whose rows it draws, the function that draws it)."""


def draw_all(rows: dict[str, list[dict]], folder: Path) -> None:
    """Draw the plots of `rows` {table: its kept rows} as PNG files into `folder`. Other tables' plots stay as they are."""
    for name, (table, draw) in PLOTS.items():
        if table in rows:
            draw(Results(rows[table]), folder / f"{name}.png")
