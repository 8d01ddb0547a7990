"""`clgs encode RUN -o scene.clgs`: a trained scene to one compressed file."""

from __future__ import annotations

import argparse
from pathlib import Path

DESCRIPTION = """\
Compress a trained scene into one .clgs file.

--level: default codes every attribute by the cheapest of its modes; fast takes less time, max more
time and fewer bytes; paper is the run-length coder of the published method, for comparison.
--chunk: anchors that are decoded together, at most. `clgs decode --box` reads whole chunks, so
small ones let it read less. Of a scene of 300,000 anchors they make the file larger by 0.4 % (4096),
1.3 % (1024), 2.2 % (512), 3.8 % (256) or 7 % (128); a box with a tenth of it then reads about 2, 1.5,
1.4, 1.3 or 1.2 times a tenth of the file."""


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "encode",
        help="compress a trained scene into one .clgs file",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, metavar="RUN", help="run folder or decoded .npz")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.clgs")
    parser.add_argument("--level", default="default", help="fast, default, max or paper")
    parser.add_argument("--chunk", type=int, default=65_536, metavar="N", help="16 to 2^20; 65536")
    add_threads(parser)


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--threads``."""
    parser.add_argument("--threads", type=int, metavar="N", help="default: one a processor")


def run(args: argparse.Namespace) -> int:
    """Encode; exit code 0."""
    from clgs.cli.scene_argument import read_scene
    from clgs.codec.encode import check_options, encode
    from clgs.files import atomic_write, check_target

    check_options(args.level, args.chunk)
    check_target(args.output)
    scene, _ = read_scene(args.scene)
    data = encode(scene, args.level, args.chunk, args.threads)
    atomic_write(args.output, data)
    count = len(scene.anchors)
    per_anchor = f", {8 * len(data) / count:.1f} bits an anchor" if count else ""
    print(f"{args.output}: {len(data):,} bytes, {count:,} anchors{per_anchor}")
    return 0
