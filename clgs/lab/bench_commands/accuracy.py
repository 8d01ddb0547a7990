"""`clgs bench accuracy`: what every accuracy setting costs and how far it is from the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.view import add_size_options, positive_int, seed
from clgs.cli.tell import tell
from clgs.lab.workload_options import add_figure_options, check_figure_options

if TYPE_CHECKING:
    from clgs.lab.bench.accuracy import Point, Subject, SubjectFigures
    from clgs.opencl.device import Device

SCENES = ("small", "dense", "large", "tiny")

DESCRIPTION = """\
Time of a render and of a render with gradients against the error of picture and gradients, for
every preset of --accuracy and for sweeps of one knob at a time. The reference is a render in
float64 without truncation (no alpha cut, no stop, no tiles), computed once and kept in the user's
cache folder (CLGS_CACHE names another). Settings take turns, so that none has the better minute.
Sweeps turn one knob, the others fine: alpha cut 2^-16, inclusive stop 1e-6, exp2 of degree 6.
Columns: milliseconds (median and 5-95 % of forward; both: with gradients); error of the picture in
levels (1/255) at p99.9 and at most, and PSNR; stop: largest error by stop and exp2 alone; worst
tensor's gradient error, relative L2 and p99 by element."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    parser = kinds.add_parser(
        "accuracy",
        help="run time against error, every preset and knob",
        description=DESCRIPTION,
    )
    add = parser.add_argument
    add(
        "--scenes",
        nargs="*",
        choices=SCENES,
        default=SCENES[:3],
        help="synthetic ones (default: small dense large)",
    )
    add("--sweeps", nargs="+", default=(), help="presets and these, such as 'alpha cut', only")
    add("--scene", type=Path, help="a trained one, too: a run folder or .clgs file; needs --data")
    add("--data", type=Path, help="the dataset that it was trained on")
    add("--split", choices=("train", "test"), default="test", help="of the view (default: test)")
    add("--view", type=int, default=0, help="number of the view in the split (default: 0)")
    add_size_options(parser, "SCENE")
    add("--repeats", type=positive_int, default=20, help="rounds of times (default: 20)")
    add("--seed", type=seed, default=0, help="of the synthetic scenes (default: 0)")
    add("--device", help="number or part of the name, see `clgs devices`")
    add_figure_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0."""
    from clgs.files import write_json
    from clgs.lab.bench.accuracy import bench_accuracy
    from clgs.lab.bench.accuracy_settings import accuracy_settings
    from clgs.lab.bench.plots import plot_accuracy
    from clgs.opencl.device import Device

    settings = accuracy_settings(args.sweeps)
    check_figure_options(args)
    subjects = _subjects(args)
    device = Device(args.device)
    found = []
    for subject in subjects:
        found.append(bench_accuracy(device, subject, settings, args.repeats, _say))
        _show(found[-1])
    if args.output:
        write_json(args.output, _record(device, found))
    if args.plot:
        plot_accuracy(args.plot, found, f"{device.name}, {device.specialisation} form")
    return 0


def _say(line: str) -> None:
    tell(f"clgs: {line}")


def _subjects(args: argparse.Namespace) -> list[Subject]:
    from clgs.cli.options.scene import read_scene
    from clgs.cli.options.view import selected_views
    from clgs.errors import UsageError
    from clgs.lab.bench.accuracy import Subject, synthetic_subjects

    if (args.scene is None) != (args.data is None):
        raise UsageError("--scene and --data belong together")
    subjects = synthetic_subjects(list(args.scenes), args.seed)
    if args.scene is not None:
        quantized, _ = read_scene(args.scene)
        views = selected_views(args, quantized)
        if not 0 <= args.view < len(views):
            raise UsageError(f"--view {args.view}: there are {len(views)}, from 0")
        name = args.data.resolve().name
        subjects.append(Subject(name, quantized.dequantize(), views[args.view].camera))
    if not subjects:
        raise UsageError("no scene: name some with --scenes, or --scene and --data")
    return subjects


def _record(device: Device, found: list[SubjectFigures]) -> dict[str, object]:
    from dataclasses import asdict

    from clgs.lab.bench.accuracy import against_parity, fastest_within
    from clgs.lab.bench.facts import command_line, machine_facts

    scenes = [
        asdict(one) | {"fastest": fastest_within(one), "against_parity": against_parity(one)}
        for one in found
    ]
    return {"command": command_line(), **machine_facts(device), "scenes": scenes}


def _show(figures: SubjectFigures) -> None:
    from rich.console import Console
    from rich.table import Table

    from clgs.lab.bench.accuracy import against_parity, fastest_within

    width, height = figures.size
    table = Table(
        "setting",
        title=f"{figures.name}: {figures.gaussians:,} Gaussians, "
        f"{figures.intersections:,} intersections, {width} x {height}",
    )
    for column in ("forward", "5-95 %", "both", "p99.9", "max", "dB", "stop", "d L2", "d p99"):
        table.add_column(column, justify="right", no_wrap=True)
    for point in figures.points:
        table.add_row(*_cells(point))
    console = Console(width=max(Console().width, 110))
    console.print(table)
    for goal, best in fastest_within(figures).items():
        time = best["milliseconds"]
        text = "none" if time is None else f"{time:.2f} ms ({best['setting']})"
        print(f"  {goal}: {text}")
    for preset, ratio in against_parity(figures).items():
        both = "" if ratio["both"] is None else f", {ratio['both']:.2f}x with gradients"
        print(f"  {preset} against parity: {ratio['forward']:.2f}x{both}")


def _cells(point: Point) -> list[str]:
    forward, image = point.forward, point.image
    cells = [
        f"{point.sweep} {point.label}",
        f"{forward.median:.2f}",
        f"{forward.low:.1f}-{forward.high:.1f}",
        f"{point.both.median:.2f}" if point.both else "",
        f"{image.p999:.2g}",
        f"{image.largest:.2g}",
        f"{image.psnr:.1f}",
        f"{point.stopped.largest:.2g}" if point.stopped else "",
    ]
    if point.gradient is None:
        return [*cells, "", ""]
    worst = (max(part.values()) for part in (point.gradient.relative_l2, point.gradient.p99))
    return [*cells, *(f"{value:.1e}" for value in worst)]
