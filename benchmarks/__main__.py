"""The command line of the benchmark suite.

python -m benchmarks run CAPTURE... --plan presets ablations views pixels true_mesh roughness (or all) [--relight]
python -m benchmarks render shapes roughness
python -m benchmarks run CAPTURE... --preset preview balanced --ablation full "no cones" --seed 0 1 2
python -m benchmarks random
python -m benchmarks photographs --objects suzanne box random_3 statue.obj --effects room camera all
python -m benchmarks report --from 1234abc --write docs/benchmarks.md
python -m benchmarks diff 1234abc HEAD
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from backend.synthetic_capture.photograph.effects import EFFECTS, GROUPS
from benchmarks.row_files import read_row
from benchmarks.suite.harness import Children, command_of
from benchmarks.suite.kept_rows import ROWS, SourceError
from benchmarks.suite.plan import ABLATIONS, CHOICES, PLANS, Run, expand
from benchmarks.suite.render import CLEAN, RANDOM, SETS, photograph_name
from benchmarks.suite.runner import OtherRowsError, Suite
from blender_nep.presets import PRESETS

SCENES = range(1, 13)
"""The seeds of the random scenes. Odd seeds are for working, even seeds are only reported."""
INTERRUPTED, REFUSED = 130, 2
SOURCES = "a commit, the name of a file in the folder of the rows, a file or folder of rows, or a suite's --out"
DOCUMENTS = [Path("docs/benchmarks.md"), Path("docs/random-scenes.md"), Path("docs/lab/whole-jobs.md")]


def _count(text: str) -> int | None:
    """The number that `text` holds; None for `all`."""
    return None if text == "all" else int(text)


def parser() -> argparse.ArgumentParser:
    """The parser of the suite's command line."""
    top = argparse.ArgumentParser(prog="python -m benchmarks", description="Benchmarks: whole jobs, scored and relit.")
    commands = top.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="learn, score and relight; what is done is not done again")
    run.add_argument("captures", nargs="+", type=Path, metavar="CAPTURE", help="rendered captures with their ground truth")
    run.add_argument("--plan", nargs="+", default=[], choices=[*PLANS, "all"])
    run.add_argument("--preset", nargs="+", choices=list(PRESETS), help="these override the plan's")
    run.add_argument("--ablation", nargs="+", choices=list(ABLATIONS))
    run.add_argument("--geometry", nargs="+", choices=("own", "true"), help="true: materials on gt_mesh.ply")
    run.add_argument("--views", nargs="+", type=_count, help="photos learned from, or `all`")
    run.add_argument("--pixels", nargs="+", type=_count, help="most pixels of a photo, or `all`: the preset's")
    run.add_argument("--seed", nargs="+", type=int)
    run.add_argument(
        "--relight",
        action="store_true",
        help="score in Cycles too what has no ablation and all photos (about 100 s a run; needs bpy)",
    )
    run.add_argument("--list", action="store_true", help="say what would be run")
    render = commands.add_parser("render", help="render captures in Cycles (needs bpy): what is there is kept")
    render.add_argument("sets", nargs="+", choices=list(SETS))
    render.add_argument("--views", type=int, default=40)
    render.add_argument("--size", type=int, default=256)
    render.add_argument("--samples", type=int, default=16)
    drawn = commands.add_parser("random", help="render random scenes (needs bpy), learn and score them, write the report")
    drawn.add_argument("--scenes", nargs="+", type=int, default=list(SCENES), metavar="SEED", help="default: 1 to 12")
    drawn.add_argument("--captures", type=Path, help="folder of the rendered scenes (OUT/captures)")
    drawn.add_argument("--preset", choices=list(PRESETS), help="this overrides the plan's")
    drawn.add_argument("--size", type=int, default=200)
    drawn.add_argument("--samples", type=int, default=4)
    drawn.add_argument("--write", type=Path, default=Path("docs/random-scenes.md"), help="the document (%(default)s)")
    taken = commands.add_parser("photographs", help="the same with photographs of objects, for each effect")
    taken.add_argument("--objects", nargs="+", default=["suzanne", "box"], help="suzanne, box, random_SEED or a mesh file")
    taken.add_argument("--effects", nargs="+", default=[*EFFECTS, "all"], choices=[*EFFECTS, *GROUPS], metavar="EFFECT")
    taken.add_argument("--captures", type=Path, help="folder of the rendered captures (OUT/captures)")
    taken.add_argument("--preset", choices=list(PRESETS), help="this overrides the plan's")
    taken.add_argument("--views", type=int, default=40)
    taken.add_argument("--size", type=int, default=256)
    taken.add_argument("--samples", type=int, default=16)
    taken.add_argument("--write", type=Path, default=Path("docs/photographs.md"), help="the document (%(default)s)")
    for command in (run, drawn, taken):
        command.add_argument("--rows", type=Path, default=ROWS, help="folder in which each job's row is kept (%(default)s)")
        command.add_argument("--jobs", type=int, default=1, help="at once (%(default)s)")
        command.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
        command.add_argument("--limit", type=float, default=7200, help="seconds after which a step is killed (%(default)s)")
        command.add_argument("--retry", action="store_true", help="do failed steps, and rows of another capture, again")
    report = commands.add_parser("report", help="tables and plots of kept rows (needs matplotlib)")
    instead = f"the rows, instead of those that each marker names: {SOURCES}"
    report.add_argument("--from", nargs="+", default=[], dest="sources", metavar="SOURCE", help=instead)
    report.add_argument("--write", nargs="+", type=Path, default=DOCUMENTS, help="the documents (default: all)")
    diff = commands.add_parser("diff", help="what got better or worse from A to B; exit code 1 where anything got worse")
    for name in ("A", "B"):
        diff.add_argument(name, help=SOURCES)
    diff.add_argument("--ablation", help="compare the whole jobs of A with those of B that have this ablation")
    for command in (report, diff):
        command.add_argument("--rows", type=Path, default=ROWS, help="folder of the kept rows (%(default)s)")
    for command in (run, render, drawn, taken):
        command.add_argument("--out", type=Path, default=Path("out/benchmarks"))
    for command in (run, render, drawn, taken):
        command.add_argument("--threads", type=int, default=1, help="of a process (%(default)s)")
    return top


def other_size(names: Iterable[str], captures: Path, size: int) -> str:
    """Why the captures of these names in the folder `captures` cannot be kept: a photo of one is not `size` pixels wide.

    Empty where all can be kept. Captures that are not there, or do not tell a width, are no reason.
    """
    for folder in (captures / name for name in names):
        width = read_row(folder / "transforms.json").get("w", size)
        if width != size:
            return (
                f"{folder} has photos that are {width} pixels wide, and {size} are asked for. Give --size {width}, give "
                "another folder, or remove this one."
            )
    return ""


def render_captures(names: Mapping[str, str], captures: Path, views: int, options: argparse.Namespace) -> int:
    """Render captures into the folder `captures`. `names`: {name of a capture: what suite/render.py calls it}.

    What is there is kept.

    Returns 1 where a render failed, REFUSED where photos of another size are there (nothing is rendered then), otherwise 0.
    """
    if refusal := other_size(names, captures, options.size):
        print(refusal, file=sys.stderr)
        return REFUSED
    failed, children = 0, Children()
    for name, what in names.items():
        folder, log = captures / name, captures / f"{name}.log"
        if (folder / "transforms.json").is_file():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        numbers = (views, options.size, options.samples, options.threads)
        command = command_of("benchmarks.suite.render", what, folder.absolute(), *numbers)
        ended = children.run(command, log, options.threads, 24 * 3600)
        print(f"{folder}: {'failed, see its log' if ended.code else 'rendered'}", file=sys.stderr, flush=True)
        failed += ended.code != 0
    return int(failed > 0)


def random_scenes(options: argparse.Namespace) -> int:
    """Render the random scenes, run and score a job on each, and write the report.

    Returns 1 where anything failed, REFUSED where scenes or rows that are there are in the way, otherwise 0.
    """
    from benchmarks.reports.random_scenes import write_random_report

    captures = (options.captures or options.out / "captures").resolve()
    names = {f"{RANDOM}{seed}": f"{RANDOM}{seed}" for seed in options.scenes}
    failed = render_captures(names, captures, 0, options)
    if failed == REFUSED:
        return REFUSED
    rendered = [captures / name for name in names if (captures / name / "transforms.json").is_file()]
    runs = expand(["random"], rendered, {"preset": (options.preset,)} if options.preset else {})
    ended = run_all(options, runs)
    if not any("score" in read_row(options.out / "rows" / f"{run.name}.json") for run in runs):
        print(f"no scene has a score: {options.write} stays as it is", file=sys.stderr)
        return ended or failed
    if ended != REFUSED:
        missing = write_random_report(options.out, captures, options.scenes, runs, options.write)
        for marker in missing:
            print(f"{options.write} has no marker {marker!r}", file=sys.stderr)
    return ended or failed


def photographs(options: argparse.Namespace) -> int:
    """Render photographs of each object with each effect, run and score a job on each, and fill the table of costs.

    Returns 1 where anything failed, REFUSED where captures or rows that are there are in the way, otherwise 0.
    """
    from benchmarks.reports.photograph_tables import photograph_table
    from benchmarks.reports.report import fill
    from benchmarks.suite.kept_rows import load

    captures, names = (options.captures or options.out / "captures").resolve(), {}
    for thing in options.objects:
        what = str(Path(thing).resolve()) if Path(thing).suffix else thing
        names |= {photograph_name(thing, effect): f"{what}+{effect}" for effect in (CLEAN, *options.effects)}
    failed = render_captures(names, captures, options.views, options)
    if failed == REFUSED:
        return REFUSED
    rendered = [captures / name for name in names if (captures / name / "transforms.json").is_file()]
    ended = run_all(options, expand(["photographs"], rendered, {"preset": (options.preset,)} if options.preset else {}))
    if ended == REFUSED:
        return REFUSED
    table = photograph_table(row for row in load(options.out) if row["capture"] in names)
    print(table)
    fill(options.write, {"photographs": table})
    return ended or failed


def run_all(options: argparse.Namespace, runs: list[Run], relight: bool = False) -> int:
    """Run these runs.

    Returns 1 where a run failed, REFUSED where rows of another capture or preset are in the way, otherwise 0.
    """
    suite = Suite(options.out, options.threads, options.device, options.limit, relight, options.retry, rows=options.rows)
    try:
        return int(suite.run_all(runs, options.jobs) > 0)
    except OtherRowsError as error:
        print(error, file=sys.stderr)
        return REFUSED


def report(documents: Sequence[Path], sources: Sequence[str], rows: Path) -> int:
    """Write the tables of the documents, and the plots into the folders that have the documents' names without ending.

    Returns REFUSED, and writes nothing more, where a source holds no rows, otherwise 0.
    """
    from benchmarks.reports.plots import draw_all
    from benchmarks.reports.report import write_report

    for document in documents:
        try:
            used = write_report(document, sources, rows)
        except SourceError as error:
            print(error, file=sys.stderr)
            return REFUSED
        draw_all(used, document.with_suffix(""))
        print(f"{document}: {', '.join(used) or 'nothing to fill'}", file=sys.stderr)
    return 0


def diff(options: argparse.Namespace) -> int:
    """Print what got better or worse. Returns 1 where anything got worse, REFUSED where nothing can be compared, else 0."""
    from benchmarks.reports.diff import compare, with_ablation
    from benchmarks.suite.kept_rows import rows_of

    name = f"{options.B}, {options.ablation}" if options.ablation else options.B
    try:
        a, b = (rows_of(source, options.rows) for source in (options.A, options.B))
        comparison = compare(*with_ablation(a, b, options.ablation) if options.ablation else (a, b))
    except SourceError as error:
        print(error, file=sys.stderr)
        return REFUSED
    print(comparison.text(options.A, name))
    return REFUSED if not comparison.pairs else int(comparison.got_worse)


def main(arguments: list[str] | None = None) -> int:
    """Run the command. Returns 0; 1 where a run failed; 2 where it was refused; 130 where it was interrupted.

    SIGTERM interrupts as Ctrl-C does. What the command has started ends with it.
    """
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return run_command(arguments)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)


def run_command(arguments: list[str] | None) -> int:
    """Run the command. Returns the exit codes of `main`; an interrupt goes through."""
    top = parser()
    options = top.parse_args(arguments)
    if options.command == "render":
        names = {name: name for chosen in options.sets for name in SETS[chosen]}
        return render_captures(names, options.out / "captures", options.views, options)
    if options.command == "random":
        if not options.write.is_file():
            top.error(f"{options.write} is no file: give a copy of docs/random-scenes.md, whose markers the report fills")
        return random_scenes(options)
    if options.command == "photographs":
        from benchmarks.reports.report import require_markers

        require_markers(top, options.write, "photographs")
        return photographs(options)
    if options.command == "report":
        for document in options.write:
            if not document.is_file():
                top.error(f"{document} is no file: give a copy of a document of docs, whose markers the report fills")
        return report(options.write, options.sources, options.rows)
    if options.command == "diff":
        return diff(options)
    captures = [capture.resolve() for capture in options.captures]
    for capture in captures:
        if not (capture / "transforms.json").is_file():
            top.error(f"{capture} is no capture: it has no transforms.json")
    if len({capture.name for capture in captures}) < len(captures):
        top.error("two captures have the same name, and rows are told apart by it")
    wanted = {key: tuple(getattr(options, key)) for key in CHOICES if getattr(options, key) is not None}
    runs = expand(options.plan, captures, wanted)
    if options.list:
        print(*(run.name for run in runs), sep="\n")
        return 0
    return run_all(options, runs, options.relight)


if __name__ == "__main__":
    sys.exit(main())
