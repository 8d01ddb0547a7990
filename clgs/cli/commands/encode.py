"""`clgs encode RUN -o scene.clgs`: a trained scene to one compressed file."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    add_device_name,
    add_files,
    add_level,
    add_size_options,
    add_threads,
    in_range,
    number_within,
    plain_digits,
    positive_int,
    size,
    view_options,
    whole_number,
)
from clgs.options import MAX_LAYERS

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from clgs.scene.scene import QuantizedScene
    from clgs.workflow.smaller import FittedScene

DESCRIPTION = """\
Compress a trained scene into one .clgs file.

--level: default codes every attribute by the cheapest of its modes; fast takes less time, max more
time and fewer bytes; paper is the run-length coder of the published method, for comparison.
--chunk: anchors that are decoded together, at most. `clgs decode --box` reads whole chunks, so
small ones let it read less. They make the file larger by 0.2 to 0.5 % (4096), 0.3 to 0.7 % (1024),
0.8 to 1.4 % (256), 1.3 to 2.3 % (128) or 2.3 to 5.5 % (64), the more the fewer anchors there are; a
box with a tenth of 300,000 anchors then reads about 2, 1.5, 1.3, 1.2 or 1.2 times a tenth of it.
Below 256, max is no smaller than default, and paper grows by a quarter (64).
--layers N: the file is made of N layers, and its beginning up to the end of any of them is a
coarser scene, the first one of several with about a tenth of the bytes. Anchors come in the order
of their importance: opacity times area in training views (--data, or the data set that RUN names),
or else from all around. If features have 3 integers per unit or more, the last of 3 layers or more,
almost half of the bytes, adds the precision of all anchors: before it, they have a third of it. 4
layers cost 0.8 to 3.7 % of the bytes at level default, up to 8 % at the other levels. To meet a
target too, encode to the target first, and that file in layers.
--data alone: the file learns of its photos, as those of older versions have not, so that it is
drawn right at other sizes than theirs. --downscale or --max-size say at which size they were
trained on, if RUN is no run folder.
--mlp: float32 keeps the weights of the MLPs as floats, auto packs them as integers if training
has rounded them; the same weights come back either way.

--target-size and --target-psnr make a smaller file without training: anchors are left out, least
useful first, and Q of offsets, features and scalings are made coarser; Q of positions stays. With
--data the training views (48 at most) say what is useful, and 12 of them, or --all-views, what it
costs in PSNR. Without, Q are made coarser by fixed shares, and anchors go only if that does not
suffice, those first that show least from all around. A target that a file without anchors exceeds
in size, or reaches in PSNR, is refused.

RUN is a run folder, the .npz or .clgs file of a scene, or a PLY file of anchors as the reference
code writes it (f_offset_*, f_anchor_feat_*, scale_*): X.quantized.ply holds integers, any other
name numbers that are rounded by --q. PLY files hold no MLPs: they are read from X.mlps.npz next to
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
        type=positive_int,
        metavar="N",
        help="most anchors per chunk, 16 to 2^20 (default: 65536, with --layers 1024)",
    )
    parser.add_argument(
        "--layers",
        type=whole_number(MAX_LAYERS),
        metavar="N",
        help="this many layers, the most important anchors first",
    )
    parser.add_argument("--mlps", type=Path, metavar="FILE.npz", help="MLPs of a PLY file")
    parser.add_argument(
        "--q",
        type=_scales,
        metavar="P,O,A,S",
        help="integers per unit of position, offset, feature and scaling of a PLY file (default: "
        "as its comments say, else 200,1,1,8); of X.quantized.ply only if they say none",
    )
    parser.add_argument("--mlp", default="auto", help="auto or float32 (default: auto)")
    targets = parser.add_mutually_exclusive_group()
    targets.add_argument("--target-size", type=size, metavar="BYTES", help="such as 800k or 1.5M")
    decibel = number_within(-sys.float_info.max, sys.float_info.max, "of dB")
    targets.add_argument("--target-psnr", type=decibel, metavar="DB", help="such as 29.5")
    parser.add_argument("--data", type=Path, help="the dataset that RUN was trained on")
    add_size_options(parser, "RUN")
    parser.add_argument(
        "--all-views",
        action="store_true",
        help="measure PSNR on all training views (default: on 12 that lie far from each other)",
    )
    add_device_name(parser)
    add_threads(parser)


def run(args: argparse.Namespace) -> int:
    """Encode; exit code 0."""
    from clgs.cli.display import Display
    from clgs.codec.scene_encoder import check_options, encode, suits_details
    from clgs.data.splats.anchors import load_scaffold, mlps_path
    from clgs.errors import UsageError
    from clgs.files import atomic_write
    from clgs.scene.anchors import QuantizationScales
    from clgs.workflow.outputs import check_new, check_suffix
    from clgs.workflow.scenes import read_scene, run_folder

    path, is_ply = args.scene, args.scene.suffix.lower() == ".ply"
    check_options(args.level, args.chunk, args.mlp, args.layers)
    mlps = (args.mlps or mlps_path(path)) if is_ply else run_folder(path) / "scene.npz"
    check_new(args.output, args.overwrite, path, mlps)
    check_suffix(args.output, ".clgs")
    target = args.target_size is not None or args.target_psnr is not None
    _check_together(args.all_views, target, args.layers)
    views = view_options(vars(args))
    sized = (args.downscale, args.max_size) != (None, None)
    if target or args.layers or args.data or sized:  # imports what a plain encode does not need
        from clgs.workflow.smaller import encode_within, importance_in_views, with_photos
        from clgs.workflow.views import check_photo_options, data_of, known_data
    if is_ply:
        scene = load_scaffold(path, args.mlps, QuantizationScales(*args.q) if args.q else None)
    elif args.mlps or args.q:
        raise UsageError(f"{path}: --mlps and --q are for a PLY file; leave them out")
    else:
        scene, _ = read_scene(path)
    if (target or args.layers) and views.data is None:
        needed = args.target_psnr is not None or args.all_views
        views = replace(views, data=data_of(path) if needed else known_data(path))
    if sized:
        check_photo_options(views)
    if args.data and not (target or args.layers):
        with Display() as display:
            scene = with_photos(path, scene, views, display)

    def pack(scene: QuantizedScene, importance: npt.NDArray[np.float64] | None = None) -> bytes:
        options = args.level, args.chunk, args.threads, args.mlp, args.layers
        with _in_words_of_options(path):
            details = suits_details(scene, args.layers or 0)
            return encode(scene, *options, importance, details=details)

    if target:
        with Display() as display:
            targets = args.target_size, args.target_psnr
            fitted = encode_within(path, scene, pack, views, *targets, args.all_views, display)
        _show_fitted(fitted, len(scene.anchors))
        scene, data = fitted.found.scene, fitted.found.data
    elif args.layers and views.data is not None:
        with Display() as display:
            data = pack(scene, importance_in_views(path, scene, views, display))
    else:
        data = pack(scene)
    atomic_write(args.output, data)
    show(args.output, len(data), len(scene.anchors))
    return 0


def _check_together(all_views: bool, target: bool, layers: int | None) -> None:
    """Raise UsageError if an option has no use, or does not go with another."""
    from clgs.errors import UsageError

    if all_views and not target:
        raise UsageError("--all-views serves --target-size and --target-psnr; give one of them")
    if target and layers:
        raise UsageError("--layers and a target: encode to the target, then that file in layers")


def show(path: Path, size: int, anchors: int) -> None:
    """Print what was written: its bytes and anchors."""
    per_anchor = f", {8 * size / anchors:.1f} bits per anchor" if anchors else ""
    print(f"{path}: {size:,} bytes, {anchors:,} anchors{per_anchor}")


def _show_fitted(fitted: FittedScene, anchors: int) -> None:
    """Print what a target cost; ``anchors`` there were before."""
    found = fitted.found
    coarser = ", ".join(f"Q of {name} x {factor:.3g}" for name, factor in found.factors.items())
    kept = f"kept {len(found.scene.anchors):,} of {anchors:,} anchors"
    print(f"{kept}; {coarser or 'all Q as they were'}")
    if found.psnr is None:
        print("PSNR cost: not measured; name the dataset with --data, which also chooses better")
        return
    before, after = found.psnr
    print(
        f"PSNR on {fitted.measured} of {fitted.views} training views: {before:.2f} dB -> "
        f"{after:.2f} dB ({after - before:+.2f} dB)"
    )


@contextmanager
def _in_words_of_options(path: Path) -> Iterator[None]:
    """Let a CodecError name the scene, and say which option helps."""
    from clgs.codec.octree import PositionsError
    from clgs.data.splats.anchors import is_quantized
    from clgs.errors import CodecError

    try:
        yield
    except PositionsError as error:
        remedy = "crop the scene" if error.wide else "merge rows of the same cell"
        if path.suffix.lower() == ".ply" and not is_quantized(path):
            remedy += f", or give a {'smaller' if error.wide else 'larger'} P in --q P,O,A,S"
        raise CodecError(f"{path}: {error.problem}; {remedy}") from error
    except CodecError as error:
        raise CodecError(f"{path}: {error}") from error


def _scales(text: str) -> tuple[float, float, float, float]:
    """The type of an argument of four positive numbers with commas between."""
    try:
        position, offset, feature, scaling = map(in_range, plain_digits(text).split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not four numbers P,O,A,S") from None
    return position, offset, feature, scaling
