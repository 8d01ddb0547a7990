"""Options of the benchmarks that make scenes of their own, and of those that draw figures."""

from __future__ import annotations

import argparse
from pathlib import Path

from clgs.cli.options.view import positive_int, seed, whole_number

gaussian_count = whole_number(20_000_000)
"""No device of today has memory for more."""

edge_length = whole_number(16_384)
"""Pixels; a picture of more would not fit into an array of a device."""


def picture_size(text: str) -> tuple[int, int]:
    """Width and height: "1920x1080", or one number for both."""
    edges = text.lower().split("x")
    if len(edges) > 2 or "" in edges:
        raise argparse.ArgumentTypeError(f"{text} is not WIDTHxHEIGHT, such as 1920x1080")
    return edge_length(edges[0]), edge_length(edges[-1])


element_count = whole_number(100_000_000)


def add_step_options(parser: argparse.ArgumentParser) -> None:
    """Add what says which step is timed, how often and where: scene, picture, device, JSON."""
    add = parser.add_argument
    add(
        "--gaussians",
        type=gaussian_count,
        default=200_000,
        help="Gaussians with positive opacity (default: 200000)",
    )
    add(
        "--size",
        type=picture_size,
        default=(400, 400),
        metavar="N|WxH",
        help="width and height of the image, pixels (default: 400x400)",
    )
    add(
        "--repeats", type=positive_int, default=15, help="steps to take the median of (default: 15)"
    )
    add("--seed", type=seed, default=0, help="of the scene (default: 0)")
    add("--device", help="number or part of the name, see `clgs devices`")
    add("--json", type=Path, metavar="F", help="write the times to F")


def add_figure_options(parser: argparse.ArgumentParser) -> None:
    """Add --output and --plot."""
    add = parser.add_argument
    add("-o", "--output", type=Path, metavar="F", help="write all figures to F (JSON)")
    add("--plot", type=Path, metavar="F.svg", help="draw them to F.svg (needs matplotlib)")


def check_figure_options(args: argparse.Namespace) -> None:
    """Refuse, before anything is measured, files that could not be written.

    Raises:
        UsageError: the plot is not an .svg file, or matplotlib is missing.
        OutputError: as from ``clgs.files.check_target``.
    """
    from clgs.errors import UsageError
    from clgs.files import check_target
    from clgs.lab.bench.plots import require_pyplot

    if args.plot and args.plot.suffix.lower() != ".svg":
        raise UsageError(f"{args.plot}: plots are SVG; name a file that ends in .svg")
    targets = [check_target(path) for path in (args.output, args.plot) if path]
    if len(set(targets)) < len(targets):
        raise UsageError(f"{args.plot}: --output and --plot name the same file; choose two")
    if args.plot:
        require_pyplot()
