"""`clgs bench`: the options of every benchmark. ``clgs.lab.bench`` has a module per benchmark."""

from __future__ import annotations

import argparse
import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from clgs.cli.options import (
    add_device_name,
    add_overwrite,
    add_size_options,
    positive_int,
    seed,
    view_options,
    whole_number,
)
from clgs.lab.commands import add_device_option

SYNTHETIC_SCENES = ("small", "dense", "large", "tiny")

gaussian_count = whole_number(20_000_000)
"""No device of today has memory for more."""

edge_length = whole_number(16_384)
"""Pixels; a picture of more would not fit into an array of a device."""

element_count = whole_number(100_000_000)


def picture_size(text: str) -> tuple[int, int]:
    """Width and height: "1920x1080", or one number for both."""
    edges = text.lower().split("x")
    if len(edges) > 2 or "" in edges:
        raise argparse.ArgumentTypeError(f"{text} is not WIDTHxHEIGHT, such as 1920x1080")
    return edge_length(edges[0]), edge_length(edges[-1])


def register(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks and their options."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    for name, kind in KINDS.items():
        child = kinds.add_parser(name, help=kind.measures)
        kind.add(child)
        add_overwrite(child, "files of figures that exist (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark that was asked for and return its exit code.

    Raises:
        ClgsError, DeviceError: memory is short; the message names the options that need less.
    """
    from clgs.errors import ClgsError, DeviceError, NoRoomError
    from clgs.lab.figures import check_figure_files

    remedy = f"{KINDS[args.kind].smaller} less"
    measure = importlib.import_module(f"clgs.lab.bench.{args.kind}").run
    given = vars(args) | {"views": view_options(vars(args))}
    file = given.get("output") or given.get("json")
    check_figure_files(file, given.get("plot"), args.overwrite)
    try:
        wanted = inspect.signature(measure).parameters
        code: int | None = measure(**{name: given[name] for name in wanted})
    except NoRoomError as error:
        raise DeviceError(f"{error.problem}; {remedy}") from error
    except MemoryError as error:
        raise ClgsError(f"out of memory ({error}); {remedy}") from error
    return code or 0


def add_step(parser: argparse.ArgumentParser) -> None:
    """Add the scene, the picture, the device and the JSON file of a timed training step."""
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
    add_device_name(parser)
    add("--json", type=Path, metavar="F", help="write the times to F")


def add_gsplat(parser: argparse.ArgumentParser) -> None:
    """Add the options of a step that gsplat makes, too."""
    parser.description = (
        "Times of this device and of gsplat on the same Gaussians of a seeded synthetic scene. "
        "Both run on the same card if --device names it. The step of clgs has MLPs, that of "
        "gsplat has none."
    )
    add_step(parser)


def add_ops(parser: argparse.ArgumentParser) -> None:
    """Add sizes of all stages, and a device that is by default each."""
    parser.description = (
        "Time of every stage (median) and its largest error against float64, on every device. GB/s "
        "and GFLOP/s count what a stage must move and compute at least "
        "(clgs/lab/bench/ops.py states the formulas). The last column is the stage's "
        "share of the copy bandwidth or of the FMA rate that the device reaches, whichever is "
        "larger. Exit code 1 if an error exceeds its limit."
    )
    add = parser.add_argument
    add(
        "--gaussians", type=gaussian_count, help="Gaussians with positive opacity (default: 200000)"
    )
    add("--size", type=edge_length, help="width and height of the image, pixels (default: 400)")
    add("--elements", type=element_count, help="for stages timed alone (default: 1000000)")
    add("--repeats", type=positive_int, help="runs to take the median of (default: 15)")
    add("--seed", type=seed, help="of the scene (default: 0)")
    add_device_option(parser)
    add("--json", type=Path, metavar="F", help="write all figures to F")


def add_accuracy(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the sweeps and the figure's files."""
    parser.description = (
        "Time of a render and of a render with gradients against the error of picture and "
        "gradients, for every preset of --accuracy and for sweeps of one knob at a time. The "
        "reference is a render in float64 without truncation (no alpha cut, no stop, no tiles). It "
        "is computed once and kept in the user's cache folder (CLGS_CACHE names another). Settings "
        "take turns, so that none has the better minute. A sweep turns one knob and leaves the "
        "others fine: alpha cut 2^-16, inclusive stop 1e-6, exp2 of degree 6. Columns: "
        "milliseconds (median and 5-95 % of forward; both: with gradients); error of the picture "
        "in levels (1/255) at p99.9 and at most, and PSNR; stop: largest error by stop and exp2 "
        "alone; worst tensor's gradient error, relative L2 and p99 by element."
    )
    add = parser.add_argument
    add(
        "--scenes",
        nargs="*",
        choices=SYNTHETIC_SCENES,
        default=SYNTHETIC_SCENES[:3],
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
    _add_figure_options(parser)


def add_scaling(parser: argparse.ArgumentParser) -> None:
    """Add the sizes and the figure's files."""
    parser.description = (
        "Time of a training step against the number of Gaussians (at 400 x 400 pixels, 10,000 to "
        "2 million) and of pixels (of 100,000 Gaussians, 0.04 to 8 megapixels), with the exponent "
        "of growth by least squares on logarithms; device memory per Gaussian, per intersection "
        "and per pixel."
    )
    add = parser.add_argument
    add("--gaussians", type=gaussian_count, nargs="+", help="other numbers; two give an exponent")
    add("--sizes", type=edge_length, nargs="+", help="other edges of the picture, pixels; as above")
    add("--repeats", type=positive_int, default=15, help="most steps per size (default: 15)")
    _add_figure_options(parser)


def _add_figure_options(parser: argparse.ArgumentParser) -> None:
    """Add --device, --output and --plot."""
    add_device_name(parser)
    add = parser.add_argument
    add("-o", "--output", type=Path, metavar="F", help="write all figures to F (JSON)")
    add("--plot", type=Path, metavar="F.svg", help="draw them to F.svg (needs matplotlib)")


def add_codec(parser: argparse.ArgumentParser) -> None:
    """Add the files that are coded, or how much is drawn."""
    parser.description = (
        "Bytes and times of every level (medians of alternating runs, one thread), compared with "
        "zstd -19, xz -9 and brotli 11 on the same integers in their narrowest type. DATA: .npz "
        "files with `values` (rows in Morton order) or `positions`, .clgs files, or folders of "
        "them; without DATA seeded random numbers with the published bits per number. The ratio is "
        "to the bytes of the published coder if they are known, otherwise to the level paper."
    )
    add = parser.add_argument
    add("data", type=Path, nargs="*", metavar="DATA", help="files or folders")
    add(
        "--anchors",
        type=positive_int,
        help="number of anchors with seeded values (default: 312238)",
    )
    add("--quick", action="store_true", help="as --anchors 20000")
    add("--seed", type=seed, default=0, help="of the seeded numbers (default: 0)")
    add("--repeats", type=positive_int, default=3, help="runs to take the median of (default: 3)")
    add("--levels-only", action="store_true", help="without the other compressors, which are slow")
    add("--json", type=Path, metavar="F", help="write all figures to F")


class Kind(NamedTuple):
    """A benchmark: ``run`` of the module of its name in ``clgs.lab.bench`` takes its options.

    add: adds its options; measures: one line of help; smaller: what to change if memory is short.
    """

    add: Callable[[argparse.ArgumentParser], None]
    measures: str
    smaller: str


KINDS = {
    "step": Kind(
        add_step,
        "one training step on a seeded synthetic scene",
        "a smaller --size or fewer --gaussians need",
    ),
    "ops": Kind(
        add_ops,
        "every stage: time, error, share of the device's limits",
        "a smaller --size, fewer --gaussians or --elements need",
    ),
    "accuracy": Kind(
        add_accuracy,
        "run time against error, every preset and knob",
        "fewer or smaller --scenes, or a larger --downscale of --scene, need",
    ),
    "scaling": Kind(
        add_scaling,
        "growth of time and memory with Gaussians and pixels",
        "smaller --sizes or fewer --gaussians need",
    ),
    "codec": Kind(
        add_codec,
        "the codec's levels: bytes, and times to encode and decode",
        "fewer --anchors, or smaller DATA with --levels-only, need",
    ),
    "gsplat": Kind(
        add_gsplat,
        "rasteriser and step compared with gsplat's (needs torch with CUDA, and gsplat)",
        "a smaller --size or fewer --gaussians need",
    ),
}
