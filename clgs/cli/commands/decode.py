"""`clgs decode scene.clgs -o scene.npz`: a compressed file back to arrays, bit for bit."""

from __future__ import annotations

import argparse

from clgs.cli.options import add_box, add_files, add_threads, positive_int

DESCRIPTION = """\
Decompress a .clgs file into a NumPy archive, or into a PLY file as the reference code writes it.

X.ply receives the anchors as numbers, X.quantized.ply as integers, and X.mlps.npz next to it the
MLPs; all in the scene's own units, with scales, transform and settings as comments. Properties are
float32, or float64 if float32 would not give every integer back. An X.mlps.npz with the same MLPs
stays; one with others is replaced by --overwrite alone.

--box: only the anchors with x0 <= x < x1, y0 <= y < y1 and z0 <= z < z1, in the units of the input
data; `clgs info` shows the extent. Of the file, only the header, the MLPs and the chunks that the
box meets are read: see `clgs encode --chunk`.

A file of `clgs encode --layers` that was cut, as by a download that broke off, gives the scene of
the layers that it has, and a warning says which. --layers N: only the first N."""

LESS_MEMORY = "--threads 1 needs less, and --box decodes a part alone"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    add_files(parser, "scene", "FILE.clgs", "FILE.npz|FILE.ply")
    add_box(parser)
    parser.add_argument("--layers", type=positive_int, metavar="N", help="only the first N layers")
    add_threads(parser)


def run(args: argparse.Namespace) -> int:
    """Decode; exit code 0."""
    from clgs.cli.tell import tell
    from clgs.data.splats.anchors import mlps_path, save_scaffold
    from clgs.errors import UsageError
    from clgs.files import check_output
    from clgs.scene.region import Box
    from clgs.scene.storage import save_scene
    from clgs.workflow.outputs import check_new
    from clgs.workflow.scenes import read_bitstream, read_box

    suffix = args.output.suffix.lower()
    if suffix not in (".npz", ".ply"):
        raise UsageError(f"{args.output}: the output must end in .npz or .ply; name it so")
    for output in [args.output] + [mlps_path(args.output)] * (suffix == ".ply"):
        check_output(output, args.scene)
    check_new(args.output, args.overwrite, args.scene)
    read = ""
    if args.box is None:
        scene, _ = read_bitstream(args.scene, args.threads, args.layers)
    else:
        x0, y0, z0, x1, y1, z1 = args.box
        box = Box((x0, y0, z0), (x1, y1, z1))
        scene, count, size = read_box(args.scene, box, args.threads, args.layers)
        read = f" in the box, {count:,} of {size:,} bytes read"
        if not len(scene.anchors):
            tell(f"clgs: warning: the box holds no anchors; `clgs info {args.scene}` shows where")
    if suffix == ".ply":
        save_scaffold(args.output, scene, args.overwrite)
    else:
        save_scene(args.output, scene)
    mlps = f"; MLPs in {mlps_path(args.output)}" if suffix == ".ply" else ""
    print(f"{args.output}: {len(scene.anchors):,} anchors{read}{mlps}")
    return 0
