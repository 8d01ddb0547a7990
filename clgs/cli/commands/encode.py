"""`clgs encode RUN -o scene.clgs`: a trained scene to one compressed file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.commands.encode_target import add_target_options
from clgs.cli.options.codec import add_files, add_level, add_threads, in_range

if TYPE_CHECKING:
    from clgs.scene.scene import QuantizedScene

DESCRIPTION = """\
Compress a trained scene into one .clgs file.

--level: default codes every attribute by the cheapest of its modes; fast takes less time, max more
time and fewer bytes; paper is the run-length coder of the published method, for comparison.
--chunk: anchors that are decoded together, at most. `clgs decode --box` reads whole chunks, so
small ones let it read less. They make the file larger by 0.2 to 0.5 % (4096), 0.3 to 0.7 % (1024),
0.8 to 1.4 % (256), 1.3 to 2.3 % (128) or 2.3 to 5.5 % (64), the more the fewer anchors there are; a
box with a tenth of 300,000 anchors then reads about 2, 1.5, 1.3, 1.2 or 1.2 times a tenth of it.
Below 256, max is no smaller than default, and paper grows by a quarter (64).
--mlp: float32 keeps the weights of the MLPs as floats, auto packs them as integers if training
has rounded them; the same weights come back either way.

--target-size and --target-psnr make a smaller file without training: anchors are left out, least
useful for each bit first, and Q of offsets, features or scalings is made coarser if that costs
less; Q of positions stays. With --data the training views (48 at most) say what is useful, and 12
of them, or --all-views, what it costs in PSNR; without, an anchor's size says what is useful. A
target that a file without anchors exceeds in size, or reaches in PSNR, is refused.

RUN is a run folder, the .npz or .clgs file of a scene, or a PLY file of anchors as the reference
code writes it (f_offset_*, f_anchor_feat_*, scale_*): X.quantized.ply holds integers, any other
name numbers that are rounded by --q. PLY files hold no MLPs: they are read from X.mlps.npz beside
it, or from --mlps. That archive holds the arrays of the torch file under their names there
(opacity_mlp.0.weight ... color_mlp.2.bias), as its owner saves them by np.savez, or the array
`mlps` of a decoded scene. nx ny nz, opacity and rot_* are not used."""

LESS_MEMORY = "--threads 1 and --level fast need less"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    add_files(parser, "scene", "RUN", "FILE.clgs")
    add_level(parser)
    parser.add_argument(
        "--chunk",
        type=int,
        default=65_536,
        metavar="N",
        help="most anchors per chunk, 16 to 2^20 (default: 65536)",
    )
    parser.add_argument("--mlps", type=Path, metavar="FILE.npz", help="MLPs of a PLY file")
    parser.add_argument(
        "--q",
        type=scales,
        metavar="P,O,A,S",
        help="integers per unit of position, offset, feature and scaling of a PLY file (default: "
        "as its comments say, else 200,1,1,8); of X.quantized.ply only if they say none",
    )
    parser.add_argument("--mlp", default="auto", help="auto or float32 (default: auto)")
    add_target_options(parser)
    add_threads(parser)


def scales(text: str) -> tuple[float, float, float, float]:
    """An argument of four positive numbers with commas between."""
    try:
        position, offset, feature, scaling = map(in_range, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not four numbers P,O,A,S") from None
    return position, offset, feature, scaling


def is_ply(path: Path) -> bool:
    """Whether the name is that of a PLY file."""
    return path.suffix.lower() == ".ply"


def sources(args: argparse.Namespace) -> list[Path]:
    """The files that are read."""
    from clgs.cli.run.source import run_folder
    from clgs.data.ply.mlps_archive import mlps_path

    if is_ply(args.scene):
        return [args.scene, args.mlps or mlps_path(args.scene)]
    return [args.scene, run_folder(args.scene) / "scene.npz"]


def read_source(args: argparse.Namespace) -> QuantizedScene:
    """The scene that is to be encoded.

    Raises:
        DataError: there is no such file, or it is damaged.
        UsageError: an option of PLY files with another scene.
    """
    from clgs.cli.options.scene import read_scene
    from clgs.data.ply.anchors import load_scaffold
    from clgs.errors import UsageError
    from clgs.scene.anchors import QuantizationScales

    if is_ply(args.scene):
        return load_scaffold(args.scene, args.mlps, QuantizationScales(*args.q) if args.q else None)
    if args.mlps or args.q:
        raise UsageError(f"{args.scene}: --mlps and --q are for a PLY file; leave them out")
    return read_scene(args.scene)[0]


@contextmanager
def in_words_of_options(path: Path) -> Iterator[None]:
    """Let a CodecError name the scene, and say which option helps."""
    from clgs.codec.octree.position_coder import PositionsError
    from clgs.data.ply.anchors import is_quantized
    from clgs.errors import CodecError

    try:
        yield
    except PositionsError as error:
        remedy = "crop the scene" if error.wide else "merge rows of the same cell"
        if is_ply(path) and not is_quantized(path):
            remedy += f", or give a {'smaller' if error.wide else 'larger'} P in --q P,O,A,S"
        raise CodecError(f"{path}: {error.problem}; {remedy}") from error
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error


def run(args: argparse.Namespace) -> int:
    """Encode; exit code 0."""
    from clgs.cli.commands.encode_target import check_targets, reduce
    from clgs.cli.options.output import check_new, check_suffix
    from clgs.codec.scene_encoder import check_options, encode
    from clgs.files import atomic_write

    check_options(args.level, args.chunk, args.mlp)
    check_new(args, args.output, *sources(args))
    check_suffix(args.output, ".clgs")
    check_targets(args)
    scene = read_source(args)

    def pack(scene: QuantizedScene) -> bytes:
        with in_words_of_options(args.scene):
            return encode(scene, args.level, args.chunk, args.threads, args.mlp)

    if args.target_size is None and args.target_psnr is None:
        data = pack(scene)
    else:
        scene, data = reduce(args, scene, pack)
    atomic_write(args.output, data)
    count = len(scene.anchors)
    per_anchor = f", {8 * len(data) / count:.1f} bits per anchor" if count else ""
    print(f"{args.output}: {len(data):,} bytes, {count:,} anchors{per_anchor}")
    return 0
