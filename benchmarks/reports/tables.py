"""Makes the Markdown tables of `docs/benchmarks.md`."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.reports import paper
from benchmarks.reports.rows import Figure, Results, failures
from benchmarks.suite.harness import markdown
from benchmarks.suite.plan import ABLATIONS
from benchmarks.suite.render import RANDOM, SETS, TURNED, WALKED
from blender_nep.presets import PRESETS

SCORES = {
    "cd_visible": ("cd visible", 4),
    "cd_full": ("cd full", 4),
    "fscore_005": ("F 0.005", 2),
    "normal_deg": ("normals, °", 1),
    "shading_normal_deg": ("shading normals, °", 1),
    "hollow_normal_deg": ("shading normals in hollows, °", 1),
    "mask_iou": ("IoU", 3),
    "background_psnr": ("F_e, dB", 1),
    "light_psnr": ("light's map, dB", 1),
    "light_correlation": ("light's map, correlation", 2),
    "mse_roughness": ("roughness", 5),
    "mse_metallic": ("metallic", 4),
    "mse_albedo": ("albedo", 5),
    "psnr_mean": ("relit, dB", 1),
    "ssim_mean": ("SSIM", 3),
    "psnr_rescaled": ("relit, albedo rescaled, dB", 1),
    "ssim_rescaled": ("SSIM, rescaled", 3),
}
"""Score -> (heading of its column, digits after the point)."""
HIGHER_IS_BETTER = frozenset(
    (
        *("fscore_005", "mask_iou", "background_psnr", "light_psnr", "light_correlation"),
        *("psnr_mean", "ssim_mean", "psnr_rescaled", "ssim_rescaled"),
    )
)
"""Of SCORES, those of which a larger one is better. Of all others, a smaller one is."""
COSTS = {"seconds": ("seconds", 0), "cpu_seconds": ("CPU s", 0), "peak_mb": ("MB", 0)}
STAGE_COSTS = {
    "cpu_seconds_fields_learning": ("fields, CPU s", 0),
    "cpu_seconds_surface": ("surface, CPU s", 1),
    "cpu_seconds_material_learning": ("materials, CPU s", 0),
    "cpu_seconds_asset": ("asset, CPU s", 1),
}
FOUR = ("suzanne", "bunny", "box", "nefertiti")
"""The captures whose means tell how the method does from commit to commit."""
HISTORY = (
    "cd_visible",
    "normal_deg",
    "shading_normal_deg",
    "background_psnr",
    "mse_roughness",
    "mse_metallic",
    "mse_albedo",
    "psnr_mean",
    "cpu_seconds",
)
"""The columns of the table of commits."""
NONE = "-"
BASELINES = ("plain NeuS color", "environment at infinity")
"""Ablations that make the assumptions of other methods: the first those of NeuS, the second those of NeRO and nvdiffrec."""


def cell(figure: Figure | None, digits: int) -> str:
    """The text of a figure: its mean and, after ±, its deviation.

    The deviation is left out where there is only one run, or where its digits are all 0.
    """
    if figure is None:
        return NONE
    text, spread = f"{figure.mean:.{digits}f}", f"{figure.deviation:.{digits}f}"
    return text + (f" ± {spread}" if figure.runs > 1 and float(spread) else "")


def cells(results: Results, columns: dict[str, tuple[str, int]], captures: Sequence[str] | None = None) -> list[str]:
    """The cells of a line of a table: means over all runs or, where `captures` is given, means over these captures."""
    found = {
        name: results.figure(name) if captures is None else results.mean_of_captures(name, captures) for name in columns
    }
    return [cell(found[name], digits) for name, (_, digits) in columns.items()]


def known(results: Results, columns: dict[str, tuple[str, int]]) -> dict[str, tuple[str, int]]:
    """The columns whose figures at least one run has."""
    return {name: column for name, column in columns.items() if results.figure(name)}


def headings(columns: dict[str, tuple[str, int]]) -> list[str]:
    """The headings of these columns."""
    return [heading for heading, _ in columns.values()]


def scored_captures(results: Results) -> list[str]:
    """The captures whose runs were scored against a true mesh."""
    return sorted(capture for capture in results.values("capture") if results.where(capture=capture).figure("cd_visible"))


def is_special(capture: str) -> bool:
    """Whether a capture is a random scene, one of `roughness`, or one of a turntable. These have tables of their own."""
    return capture.startswith(RANDOM) or capture in SETS["roughness"] or capture.endswith((TURNED, WALKED))


def main_captures(results: Results) -> list[str]:
    """The captures on which the most presets were tried. Captures of special plans are never among them."""
    full = results.whole(ablation="full")
    scored = [capture for capture in scored_captures(full) if not is_special(capture)]
    tried = {c: len({run["preset"] for run in full.where(capture=c).tried}) for c in scored}
    return [c for c in tried if tried[c] == max(tried.values())]


def presets_of(results: Results) -> list[str]:
    """The presets of the runs, the fastest first."""
    return [preset for preset in PRESETS if preset in results.values("preset")]


def table_1(results: Results) -> str:
    """A table in the form of the paper's Table 1: the paper's figures, then ours."""
    full, captures = results.whole(ablation="full"), main_captures(results)
    presets = presets_of(full)
    ours = {name: results.whole(ablation=name, preset=presets[0]) for name in BASELINES} if presets else {}
    ours = {f"{name} ({presets[0]})": one for name, one in ours.items()} | {p: full.where(preset=p) for p in presets}
    with_materials = {name: one for name, one in ours.items() if not name.startswith(BASELINES[0])}
    header = [
        "scene",
        *(f"*{name}*" for name in paper.METHODS),
        *ours,
        *(f"*{name}* r / m / a" for name in paper.METHODS[2:]),
        *(f"{name} r / m / a" for name in with_materials),
    ]
    lines = {scene: [capture for capture in captures if capture == scene.lower()] for scene in paper.CHAMFER}
    lines |= {capture: [capture] for capture in captures if capture.capitalize() not in lines}
    rows = []
    for scene, own in [*((k, v) for k, v in lines.items() if k != "Avg."), ("Avg.", captures)]:
        chamfer, errors = paper.CHAMFER.get(scene), paper.MATERIALS.get(scene)
        row = [scene, *([f"*{x:.5f}*" for x in chamfer] if chamfer else [NONE] * 4)]
        row += [cells(one, {"cd_visible": SCORES["cd_visible"]}, own)[0] for one in ours.values()]
        row += ["*" + " / ".join(f"{x:.3f}" for x in each) + "*" for each in errors] if errors else [NONE] * 2
        for one in with_materials.values():
            found = [one.mean_of_captures(f"mse_{name}", own) for name in ("roughness", "metallic", "albedo")]
            row.append(NONE if None in found else " / ".join(f"{f.mean:.4f}" for f in found))
        rows.append(row)
    return markdown(header, rows)


def presets(results: Results, columns: dict[str, tuple[str, int]] = SCORES) -> str:
    """A table with a line for each capture and preset, and the means over captures.

    Captures without any score have lines too, such as those of real photos, which have no ground truth.
    """
    full, captures, rows = results.whole(ablation="full"), main_captures(results), []
    columns = known(full, columns)
    for preset in presets_of(full):
        chosen = full.where(preset=preset)
        rows += [
            [
                capture,
                preset,
                chosen.where(capture=capture).count,
                *cells(chosen.where(capture=capture), columns),
            ]
            for capture in chosen.values("capture")
            if capture in captures or not (is_special(capture) or capture in scored_captures(chosen))
        ]
        mean = cells(chosen, columns, captures)
        rows.append(["**mean**", preset, "", *(f"**{text}**" if text != NONE else text for text in mean)])
    return markdown(["capture", "preset", "seeds", *headings(columns)], rows)


def summary(results: Results) -> str:
    """The short table: a line for each preset, with means over the main captures and their costs."""
    full, captures = results.whole(ablation="full"), main_captures(results)
    header = ["preset", "distance", "normals", "roughness / metallic / albedo", "fields", "materials", "whole job", "memory"]
    rows = []
    for preset in presets_of(full):
        chosen = full.where(preset=preset)

        def mean(name: str, form: str, chosen: Results = chosen) -> str:
            found = chosen.mean_of_captures(name, captures)
            return NONE if found is None else form.format(found.mean)

        errors = " / ".join(mean(f"mse_{name}", "{:.4f}") for name in ("roughness", "metallic", "albedo"))
        stages = [mean(f"cpu_seconds{stage}", "{:.0f} s") for stage in ("_fields_learning", "_material_learning", "")]
        memory = chosen.mean_of_captures("peak_mb", captures)
        rows.append(
            [
                preset,
                mean("cd_visible", "{:.4f}"),
                mean("normal_deg", "{:.1f} degrees"),
                errors,
                *stages,
                NONE if memory is None else f"{memory.mean / 1000:.1f} GB",
            ]
        )
    return markdown(header, rows)


def costs(results: Results) -> str:
    """A table of what each capture and preset costs: seconds, memory, faces and texels."""
    return presets(
        results,
        {
            "seconds": ("seconds", 0),
            **STAGE_COSTS,
            "cpu_seconds": ("all, CPU s", 0),
            "peak_mb": ("MB", 0),
            "faces": ("faces", 0),
            "texels": ("texels", 0),
        },
    )


def history(rows: list[dict]) -> str:
    """A table with a line for each commit and preset that was run on all of FOUR: means over them, the newest first.

    Rows of several commits, such as "25ca25c+a950af3", are left out, because their parts have lines of their own.
    """
    columns = {name: (SCORES | COSTS)[name] for name in HISTORY}
    lines = []
    for commit, date in sorted({(row["commit"], row.get("date", "")) for row in rows if "+" not in row["commit"]}):
        results = Results([row for row in rows if (row["commit"], row.get("date", "")) == (commit, date)])
        for preset in presets_of(results):
            one = results.whole(ablation="full", preset=preset, capture=FOUR.__contains__)
            if set(one.values("capture")) == set(FOUR):
                seeds = f"{one.count / len(FOUR):g}"
                lines.append((date, commit, [commit, date, preset, seeds, *cells(one, columns, FOUR)]))
    ordered = sorted(lines, key=lambda line: line[:2], reverse=True)
    return markdown(["commit", "date", "preset", "seeds", *headings(columns)], [line for *_, line in ordered])


def ablations(results: Results, geometry: str = "own") -> str:
    """A table with a line for each ablation: means over the captures on which it was run.

    The line "full" shows the runs without ablation, on the captures on which any ablation was run. `geometry` is the mesh of
    the runs, "own" or "true".
    """
    columns = {
        k: v
        for k, v in (SCORES | COSTS).items()
        if geometry == "own" or not k.startswith(("cd", "fscore", "normal", "mask", "background"))
    }
    chosen = results.whole(geometry=geometry, ablation=ABLATIONS.__contains__)
    columns = known(chosen, columns)
    header, rows = ["ablation", "captures", "runs", *headings(columns)], []
    for preset in presets_of(chosen.where(ablation=lambda name: name != "full")):
        at = chosen.where(preset=preset)
        ablated = at.where(ablation=lambda name: name != "full").values("capture")
        compared = [capture for capture in main_captures(results) if capture in ablated]
        for name in ABLATIONS:
            one = at.where(ablation=name)
            captures = [capture for capture in compared if capture in one.values("capture")]
            if captures:
                runs = one.where(capture=captures.__contains__).count
                rows.append(
                    [name if name != "full" else f"**full** ({preset})", len(captures), runs, *cells(one, columns, captures)]
                )
    return markdown(header, rows)


def ablations_by_capture(results: Results) -> str:
    """A table of the ablations: distance, error of normals and the three errors of materials, for each capture."""
    captures = main_captures(results)
    header, rows = ["ablation", "preset", *(f"{c}: cd / normals / r / m / a" for c in captures)], []
    shown = ("cd_visible", "normal_deg", "mse_roughness", "mse_metallic", "mse_albedo")
    chosen = results.whole()
    for preset in presets_of(chosen.where(ablation=lambda name: name != "full")):
        for name in ABLATIONS:
            one = chosen.where(preset=preset, ablation=name)
            if one.runs:
                parts = [[one.where(capture=c).figure(key) for key in shown] for c in captures]
                rows.append(
                    [
                        name,
                        preset,
                        *(
                            " / ".join(
                                NONE if f is None else f"{f.mean:.{SCORES[key][1]}f}"
                                for key, f in zip(shown, part, strict=True)
                            )
                            for part in parts
                        ),
                    ]
                )
    return markdown(header, rows)


def swept(results: Results, key: str, heading: str) -> str:
    """A table of scores against the number of photos (`key` is "views") or the pixels of a photo ("pixels").

    It has a line for each capture, and the mean over the captures that were run with all the numbers.
    """
    found, rows = sweeps(results, key), []
    columns = {} if not found else known(found[0][2], SCORES | COSTS)
    for preset, values, chosen in found:
        captures = [
            c for c in scored_captures(chosen) if all(chosen.where(**{"capture": c, key: value}).runs for value in values)
        ]
        for value in values:
            at = chosen.where(**{key: value})
            rows += [
                [c, preset, shown_value(at.where(capture=c), key, value), *cells(at.where(capture=c), columns)]
                for c in scored_captures(at)
            ]
        for value in values:
            at = chosen.where(**{key: value})
            rows.append(["**mean**", preset, shown_value(at, key, value), *cells(at, columns, captures)])
    return markdown(["capture", "preset", heading, *headings(columns)], rows)


def sweeps(results: Results, key: str) -> list[tuple[str, list, Results]]:
    """(preset, values of `key`, runs) for each preset whose runs have more than one value of `key`.

    The values are in the order of the photos, or pixels, that the runs have really learned from.
    """
    other = {"views": "pixels", "pixels": "views"}[key]
    found = []
    for preset in presets_of(results):
        chosen = results.where(**{"preset": preset, "ablation": "full", "geometry": "own", other: None})
        captures = [c for c in chosen.values("capture") if len(chosen.where(capture=c).values(key)) > 1]
        chosen = chosen.where(capture=lambda c, some=captures: c in some)
        values = sorted(chosen.values(key), key=lambda value, some=chosen: learned_from(some, key, value))
        if values:
            found.append((preset, values, chosen))
    return found


def learned_from(results: Results, key: str, value: int | None) -> float:
    """The mean number of photos, or of pixels of a photo, that runs whose field `key` is `value` have learned from."""
    return results.where(**{key: value}).figure(f"{key}_of_run").mean


def shown_value(results: Results, key: str, value: int | None) -> str:
    """The number of photos, or pixels, as the table shows it.

    It is the number that the runs have learned from, if that is the same for all of them. Otherwise it is `value`.
    """
    own = results.figure(f"{key}_of_run")
    return f"{own.mean:.0f}" if own and own.deviation == 0 else "all" if value is None else str(value)


def roughness(results: Results) -> str:
    """A table of the scores on the captures gold_R, which differ only in their roughness R."""
    found, rows = golds(results), []
    columns = {} if not found else known(found[0][2], SCORES | COSTS)
    for preset, captures, chosen in found:
        rows += [[f"{c.removeprefix('gold_')}", preset, *cells(chosen.where(capture=c), columns)] for c in captures]
    return markdown(["true roughness", "preset", *headings(columns)], rows)


def golds(results: Results) -> list[tuple[str, list[str], Results]]:
    """(preset, captures gold_R in rising order of R, runs) for each preset."""
    chosen = results.whole(ablation="full", capture=lambda name: name.startswith("gold_") and name[5:6].isdigit())
    return [
        (preset, sorted(one.values("capture"), key=lambda name: float(name[5:])), one)
        for preset in presets_of(chosen)
        for one in [chosen.where(preset=preset)]
    ]


def failed(rows: list[dict]) -> str:
    """A table of the runs that failed, with their messages."""
    found = [
        [run["capture"], run["preset"], run["ablation"], run["geometry"], run["views"] or "all", run["seed"], message]
        for run, message in failures(rows)
    ]
    if not found:
        return f"None of {len(rows)} runs failed."
    return f"{len(found)} of {len(rows)} runs:\n\n" + markdown(
        ["capture", "preset", "ablation", "geometry", "views", "seed", "message"], found
    )
