"""`clgs encode RUN -o scene.clgs`: a trained scene to one compressed file."""

from __future__ import annotations

import argparse
from pathlib import Path


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser("encode", help="compress a trained scene into one .clgs file")
    parser.add_argument("scene", type=Path, metavar="RUN", help="run folder or decoded .npz")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.clgs")


def run(args: argparse.Namespace) -> int:
    """Encode; exit code 0."""
    from clgs.cli.scene_argument import read_scene
    from clgs.codec.encode import encode
    from clgs.files import atomic_write, check_target

    check_target(args.output)
    scene, _ = read_scene(args.scene)
    data = encode(scene)
    atomic_write(args.output, data)
    count = len(scene.anchors)
    per_anchor = f", {8 * len(data) / count:.1f} bits an anchor" if count else ""
    print(f"{args.output}: {len(data):,} bytes, {count:,} anchors{per_anchor}")
    return 0
