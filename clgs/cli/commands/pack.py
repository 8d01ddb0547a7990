"""`clgs pack splat.ply -o splat.clgs`: ordinary Gaussian splats to one compressed file."""

from __future__ import annotations

import argparse

from clgs.cli.options import add_files, add_level, add_threads, in_range

DESCRIPTION = """\
Compress an ordinary 3DGS file (PLY: x y z, f_dc_*, f_rest_*, opacity, scale_*, rot_*, ...).

Every property is rounded to a multiple of its step, which the file states; what is packed is then
lossless. Default steps: f_dc 1/64, f_rest 1/32, opacity 1/32, scale 1/16, rot 1/256, normal 1/64;
position an eighth of the median scale (a power of two), or 1/65536 of the extent without scales,
but no finer than float32 is on an axis far from 0. Positions fit 2^21 steps per axis:
if a distant splat forces a coarser step, a warning says so. Other properties have step 1 if they
are of integer type, and need --step if not. Quaternions are scaled to length 1 and to a
rot_0 that is not negative, which is the same rotation. Splats come back in Morton order, all of
them, even if several share a voxel. `clgs unpack` is the way back."""

LESS_MEMORY = "--threads 1 and --level fast need less"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    add_files(parser, "splats", "FILE.ply", "FILE.clgs")
    parser.add_argument(
        "--step",
        type=named_step,
        action="append",
        default=[],
        metavar="NAME=STEP",
        help="of a group (position, scale, f_rest, ...) or a property, such as scale=0.03; may be "
        "given several times",
    )
    add_level(parser)
    add_threads(parser)


def named_step(text: str) -> tuple[str, float]:
    """An argument NAME=STEP."""
    name, separator, number = text.partition("=")
    if not name or not separator:
        raise argparse.ArgumentTypeError(f"{text} is not NAME=STEP")
    return name, in_range(number)


def run(args: argparse.Namespace) -> int:
    """Pack; exit code 0."""
    from clgs.cli.tell import tell
    from clgs.codec.octree import PositionsError
    from clgs.codec.splat_packing import pack
    from clgs.data.splats.gaussians import problem_of
    from clgs.data.splats.integer_splats import group_of, read_splats
    from clgs.errors import CodecError, UsageError
    from clgs.files import atomic_write
    from clgs.workflow.outputs import check_new, check_suffix

    check_new(args.output, args.overwrite, args.splats)
    check_suffix(args.output, ".clgs")
    names = [name for name, _ in args.step]
    for name in {name for name in names if names.count(name) > 1}:
        raise UsageError(f"--step {name}: is given more than once; leave one")
    splats, errors = read_splats(args.splats, dict(args.step))
    try:
        data = pack(splats, args.level, args.threads)
    except PositionsError as error:
        remedy = "crop distant ones, or give a larger --step position=STEP"
        raise CodecError(f"{args.splats}: {error.problem}; {remedy}") from error
    atomic_write(args.output, data)
    groups: dict[str, dict[str, float]] = {}
    for name, step in zip(splats.names, splats.steps, strict=True):
        groups.setdefault(group_of(name), {})[name] = step
    for group, steps in groups.items():
        shown = ", ".join(f"{step:g} of {name}" for name, step in steps.items())
        if len({*steps.values()}) == 1:
            shown = f"{min(steps.values()):g}"
        print(f"{group}: step {shown}, rounded by at most {errors[group]:.2g}")
    if problem := problem_of(splats.names) or ("" if len(splats) else "holds no splats"):
        tell(
            f"clgs: {args.splats}: {problem}: `clgs unpack` gives them back, but nothing draws them"
        )
    size = args.splats.stat().st_size
    print(
        f"{args.output}: {len(data):,} bytes, {len(splats):,} splats, "
        f"{len(data) / size:.3f} of {args.splats.name}"
    )
    return 0
