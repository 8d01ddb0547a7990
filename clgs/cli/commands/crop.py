"""`clgs crop SCENE -o FILE.clgs`: a part of a trained scene, without training."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    add_box,
    add_device_name,
    add_files,
    add_level,
    add_size_options,
    add_test_every,
    add_threads,
    numbers,
    positive_int,
    view_options,
)

if TYPE_CHECKING:
    from clgs.scene.scene import QuantizedScene

DESCRIPTION = """\
Keep a part of a trained scene, without training, and say what that does to bytes and PSNR.

Of several conditions, an anchor must meet all. What is kept keeps its integers: the picture of one
anchor stays as it was. An anchor lies where its position is; its Gaussians may reach over the edge.

--box: as in `clgs decode`: x0 <= x < x1 and so on, in the units of the input data.
--sphere: at most the radius from the centre, in the same units.
--object: what the masks of the training photos, or their alpha, show: at least half of what an
anchor adds to these photos must lie within the masks.
--seen: what at least N training photos show; an anchor must make up 0.3 pixels of each. Haze
before single cameras goes, and what is hidden everywhere.

--object and --seen need the photos. If these are known, PSNR is that of the held-out photos, over
the background where --object masks them; if none is held out, of the training photos."""

LESS_MEMORY = "--threads 1 and --level fast need less"


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    add_files(parser, "scene", "SCENE", "FILE.clgs")
    add_box(parser)
    parser.add_argument(
        "--sphere", type=numbers("x,y,z,r"), metavar="x,y,z,r", help="only the part in this sphere"
    )
    parser.add_argument(
        "--object", action="store_true", help="only what the masks of the photos show"
    )
    parser.add_argument(
        "--seen",
        type=positive_int,
        default=0,
        metavar="N",
        help="only what at least N training photos show",
    )
    where = "the one that the run folder of SCENE names"
    parser.add_argument("--data", type=Path, help=f"the data set of SCENE (default: {where})")
    add_size_options(parser, "SCENE")
    add_test_every(parser)
    add_level(parser)
    add_device_name(parser)
    add_threads(parser)


def run(args: argparse.Namespace) -> int:
    """Crop; exit code 0."""
    from dataclasses import replace

    from clgs.cli.commands.encode import show
    from clgs.cli.display import Display
    from clgs.codec.chunks import DEFAULT_CHUNK
    from clgs.codec.scene_encoder import check_options, encode
    from clgs.errors import UsageError
    from clgs.files import atomic_write
    from clgs.scene.region import Box, Sphere
    from clgs.workflow.outputs import check_new, check_suffix
    from clgs.workflow.scenes import read_scene, run_folder
    from clgs.workflow.smaller import crop
    from clgs.workflow.views import check_photo_options, known_data

    if not (args.box or args.sphere or args.object or args.seen):
        raise UsageError("nothing is asked for; give --box, --sphere, --object or --seen")
    check_options(args.level, DEFAULT_CHUNK, "auto")
    own = [run_folder(args.scene) / name for name in ("scene.npz", "scene.clgs")]
    check_new(args.output, args.overwrite, args.scene, *own)
    check_suffix(args.output, ".clgs")
    regions: list[Box | Sphere] = []
    if args.box:
        x0, y0, z0, x1, y1, z1 = args.box
        regions.append(Box((x0, y0, z0), (x1, y1, z1)))
    if args.sphere:
        x, y, z, radius = args.sphere
        regions.append(Sphere((x, y, z), radius))
    views = view_options(vars(args))
    if views.data is None:
        views = replace(views, data=known_data(args.scene))
    check_photo_options(views)
    scene, size = read_scene(args.scene)

    def pack(part: QuantizedScene) -> bytes:
        return encode(part, args.level, threads=args.threads)

    with Display() as display:
        found = crop(
            args.scene,
            scene,
            pack,
            views,
            regions=regions,
            masked=args.object,
            least_views=args.seen,
            on_event=display,
        )
        before = len(pack(scene)) if size is None else size
    atomic_write(args.output, found.data)
    show(args.scene, before, len(scene.anchors))
    show(args.output, len(found.data), len(found.scene.anchors))
    if found.psnr is None:
        print("PSNR: not measured; name the data set with --data")
        return 0
    old, new = found.psnr
    print(f"PSNR on {found.views} photos: {old:.2f} dB -> {new:.2f} dB ({new - old:+.2f} dB)")
    return 0
