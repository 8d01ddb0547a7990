"""`clgs decode scene.clgs -o scene.npz`: a compressed file back to arrays, bit for bit."""

from __future__ import annotations

import argparse
from pathlib import Path


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser("decode", help="decompress a .clgs file into a NumPy archive")
    parser.add_argument("scene", type=Path, metavar="FILE.clgs")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.npz")


def run(args: argparse.Namespace) -> int:
    """Decode; exit code 0."""
    from clgs.cli.scene_argument import read_bitstream
    from clgs.errors import UsageError
    from clgs.files import check_target
    from clgs.scene.storage import save_scene

    if args.output.suffix != ".npz":
        raise UsageError(f"{args.output}: the output must end in .npz; name it so")
    check_target(args.output)
    scene, _ = read_bitstream(args.scene)
    save_scene(args.output, scene)
    print(f"{args.output}: {len(scene.anchors):,} anchors")
    return 0
