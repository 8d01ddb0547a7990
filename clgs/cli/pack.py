"""`clgs pack splat.ply -o splat.clgs`: ordinary Gaussian splats to one compressed file."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from clgs.cli.encode import add_threads

DESCRIPTION = """\
Compress an ordinary 3DGS file (PLY: x y z, f_dc_*, f_rest_*, opacity, scale_*, rot_*, ...).

Every property is rounded to a multiple of its step, which the file states; what is packed is then
lossless. Default steps: position an eighth of the median scale (a power of two); f_dc 1/64, f_rest
1/32, opacity 1/32, scale 1/16, rot 1/256, normal 1/64. Properties of integer type have step 1, any
other needs --step. Quaternions are scaled to length 1. Splats come back in Morton order; all of
them, also where several share a voxel. `clgs unpack` is the way back."""


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "pack",
        help="compress an ordinary 3DGS PLY file",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("splats", type=Path, metavar="FILE.ply")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.clgs")
    parser.add_argument(
        "--step",
        type=named_step,
        action="append",
        default=[],
        metavar="NAME=STEP",
        help="of a group (position, scale, f_rest, ...) or a property, such as scale=0.03; again "
        "for each",
    )
    parser.add_argument("--level", default="default", help="fast, default, max or paper")
    add_threads(parser)


def named_step(text: str) -> tuple[str, float]:
    """An argument NAME=STEP, the step positive."""
    name, _, number = text.partition("=")
    try:
        step = float(number)
    except ValueError:
        step = math.nan
    if not name or not 2.0**-64 <= step <= 2.0**64:
        raise argparse.ArgumentTypeError(f"{text} is not NAME=STEP with a positive number")
    return name, step


def run(args: argparse.Namespace) -> int:
    """Pack; exit code 0."""
    from clgs.codec.splats import pack
    from clgs.data.splat_ply import group_of, read_splats
    from clgs.files import atomic_write, check_output

    check_output(args.output, args.splats)
    splats, errors = read_splats(args.splats, dict(args.step))
    data = pack(splats, args.level, args.threads)
    atomic_write(args.output, data)
    steps = {group_of(name): step for name, step in zip(splats.names, splats.steps, strict=True)}
    for group, step in steps.items():
        print(f"{group}: step {step:g}, rounded by at most {errors[group]:.2g}")
    size = args.splats.stat().st_size
    print(
        f"{args.output}: {len(data):,} bytes, {len(splats):,} splats, "
        f"{len(data) / size:.3f} of {args.splats.name}"
    )
    return 0
