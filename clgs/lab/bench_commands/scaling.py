"""`clgs bench scaling`: how time and memory of a training step grow."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from clgs.cli.options.view import positive_int
from clgs.cli.tell import tell
from clgs.lab.workload_options import (
    add_figure_options,
    check_figure_options,
    edge_length,
    gaussian_count,
)

if TYPE_CHECKING:
    from clgs.lab.bench.scaling import Growth, Run, Scaling

DESCRIPTION = """\
Time of a training step against the number of Gaussians (at 400 x 400 pixels, 10,000 to 2 million)
and of pixels (of 100,000 Gaussians, 0.04 to 8 megapixels), with the exponent of growth by least
squares on logarithms; device memory per Gaussian, per intersection and per pixel."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the kind and its options."""
    parser = kinds.add_parser(
        "scaling",
        help="growth of time and memory with Gaussians and pixels",
        description=DESCRIPTION,
    )
    add = parser.add_argument
    add("--gaussians", type=gaussian_count, nargs="+", help="other numbers; two give an exponent")
    add("--sizes", type=edge_length, nargs="+", help="other edges of the picture, pixels; as above")
    add("--repeats", type=positive_int, default=15, help="most steps per size (default: 15)")
    add("--device", help="number or part of the name, see `clgs devices`")
    add_figure_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0."""
    from dataclasses import asdict

    from clgs.files import write_json
    from clgs.lab.bench.facts import command_line, machine_facts
    from clgs.lab.bench.plots import plot_scaling
    from clgs.lab.bench.scaling import GAUSSIANS, SIZES, bench_scaling
    from clgs.opencl.device import Device

    check_figure_options(args)
    device = Device(args.device)
    found = bench_scaling(
        lambda: Device(args.device),
        args.gaussians or GAUSSIANS,
        args.sizes or SIZES,
        args.repeats,
        lambda line: tell(f"clgs: {line}"),
    )
    _show(found)
    if args.output:
        record = {"command": command_line(), **machine_facts(device), **asdict(found)}
        write_json(args.output, record)
    if args.plot:
        plot_scaling(args.plot, found, f"{device.name}, {device.specialisation} form")
    return 0


def _show(found: Scaling) -> None:
    for name, runs, exponent in (
        ("by Gaussians", found.by_gaussians, found.time_by_gaussians),
        ("by pixels", found.by_pixels, found.time_by_pixels),
    ):
        _show_sweep(name, runs, exponent)
    from clgs.lab.bench.scaling import shown

    memory = found.memory
    print(
        f"device memory: {shown(memory.per_gaussian, 0)} bytes per Gaussian and "
        f"{shown(memory.per_pixel, 0)} per pixel, each with its intersections; "
        f"{shown(memory.per_intersection, 0)} per intersection"
    )


def _show_sweep(name: str, runs: list[Run], exponent: Growth) -> None:
    from rich.console import Console
    from rich.table import Table

    from clgs.lab.bench.scaling import shown

    table = Table(
        title=f"{name}: time ~ count^{shown(exponent.exponent, 2)} "
        f"(^{shown(exponent.exponent_of_larger_half, 2)} in the larger half)"
    )
    for column in ("Gaussians", "intersections", "pixels", "step ms", "ns a Gaussian", "MiB"):
        table.add_column(column, justify="right")
    for one in runs:
        table.add_row(
            f"{one.gaussians:,}",
            f"{one.intersections:,}",
            f"{one.pixels:,}",
            f"{one.milliseconds:.1f}",
            f"{1e6 * one.milliseconds / max(one.gaussians, 1):.0f}",
            f"{one.peak_bytes / 2**20:.0f}",
        )
    Console().print(table)
