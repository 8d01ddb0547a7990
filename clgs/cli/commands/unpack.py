"""`clgs unpack splat.clgs -o splat.ply`: packed splats back to a PLY file."""

from __future__ import annotations

import argparse

from clgs.cli.options import add_files, add_threads

LESS_MEMORY = "--threads 1 needs less"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = (
        "Decompress what `clgs pack` made: a little-endian PLY file of float32, or float64 if "
        "float32 would lose a step, with the same properties and splats, rounded to the "
        "steps, in Morton order."
    )
    add_files(parser, "splats", "FILE.clgs", "FILE.ply")
    add_threads(parser)


def run(args: argparse.Namespace) -> int:
    """Unpack; exit code 0."""
    from clgs.codec.splat_packing import unpack
    from clgs.data.splats.integer_splats import write_splats
    from clgs.files import atomic_write
    from clgs.workflow.outputs import check_new, check_suffix
    from clgs.workflow.scenes import naming, read_bytes

    check_new(args.output, args.overwrite, args.splats)
    check_suffix(args.output, ".ply")
    data = read_bytes(args.splats)
    with naming(args.splats):
        splats = unpack(data, args.threads)
    atomic_write(args.output, write_splats(splats))
    print(f"{args.output}: {len(splats):,} splats, {len(splats.names)} properties")
    return 0
