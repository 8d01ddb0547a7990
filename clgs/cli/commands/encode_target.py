"""`clgs encode --target-size` and `--target-psnr`: a smaller file of the same scene."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.byte_count import byte_count
from clgs.cli.options.view import add_size_options

if TYPE_CHECKING:
    from collections.abc import Callable

    from clgs.scene.scene import QuantizedScene
    from clgs.train.quality.rate_control import Judge


def add_target_options(parser: argparse.ArgumentParser) -> None:
    """Add --target-size, --target-psnr, and what names the training views."""
    targets = parser.add_mutually_exclusive_group()
    targets.add_argument("--target-size", type=size, metavar="BYTES", help="such as 800k or 1.5M")
    targets.add_argument("--target-psnr", type=decibel, metavar="DB", help="such as 29.5")
    parser.add_argument("--data", type=Path, help="the dataset that RUN was trained on")
    add_size_options(parser, "RUN")
    parser.add_argument(
        "--all-views",
        action="store_true",
        help="measure PSNR on all training views (default: on 12 that lie far from each other)",
    )
    parser.add_argument("--device", help="number or part of the name, see `clgs devices`")
    # What the views of other commands have as options.
    parser.set_defaults(split="train", accuracy=None, smallest_anchor=None, max_memory=None)


def size(text: str) -> int:
    """An argument of bytes: a number, and k, M or G for 10^3, 10^6 or 10^9 of them."""
    value = byte_count(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text} is not a size such as 800k or 1.5M")
    return value


def decibel(text: str) -> float:
    """An argument that must be a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a number of dB")
    return value


def check_targets(args: argparse.Namespace) -> None:
    """Raise UsageError if options do not fit each other."""
    from clgs.cli.options.view import name_data, name_known_data
    from clgs.errors import UsageError

    targets = args.target_psnr is not None or args.target_size is not None
    if args.data is not None and not targets:
        raise UsageError("--data serves --target-size and --target-psnr; give one of them")
    if args.all_views and not targets:
        raise UsageError("--all-views serves --target-size and --target-psnr; give one of them")
    needed = args.target_psnr is not None or args.all_views
    if args.data is None and needed:
        name_data(args)
    elif targets:
        name_known_data(args)


def reduce(
    args: argparse.Namespace, scene: QuantizedScene, encode: Callable[[QuantizedScene], bytes]
) -> tuple[QuantizedScene, bytes]:
    """The smaller scene and its file; prints what it cost."""
    from clgs.cli.progress import bar
    from clgs.train.quality.rate_control import reduce_to_psnr, reduce_to_size

    judge, views = None, 0
    with bar(None, "looking at views" if args.data else "encoding") as advance:
        if args.data is not None:
            judge, views = _judge(args, scene, advance)
        if args.target_psnr is not None:
            assert judge is not None
            found = reduce_to_psnr(scene, args.target_psnr, encode, judge)
        else:
            found = reduce_to_size(scene, args.target_size, encode, judge)
    kept, count = len(found.scene.anchors), len(scene.anchors)
    coarser = ", ".join(f"Q of {name} x {factor:.3g}" for name, factor in found.factors.items())
    print(f"kept {kept:,} of {count:,} anchors; {coarser or 'all Q as they were'}")
    if found.psnr is None:
        print("PSNR cost: not measured; name the dataset with --data, which also chooses better")
    else:
        assert judge is not None
        before, after = found.psnr
        print(
            f"PSNR on {len(judge.views)} of {views} training views: {before:.2f} dB -> "
            f"{after:.2f} dB ({after - before:+.2f} dB)"
        )
    return found.scene, found.data


def _judge(
    args: argparse.Namespace, scene: QuantizedScene, on_render: Callable[[], None]
) -> tuple[Judge, int]:
    """The judge by the training views, and their number.

    Only the photos that are looked at are read, once.
    """
    from clgs.cli.options.view import selected_options, selected_views
    from clgs.opencl.device import Device
    from clgs.train.quality.rate_control import MAX_CAMERAS, MEASURED, Judge, spread

    every = selected_views(args, scene)
    cameras = [view.camera for view in every]
    views = [every[i] for i in spread(cameras, len(cameras) if args.all_views else MEASURED)]
    for view in views:
        view.photo.keep()
    seen = [cameras[i] for i in spread(cameras, MAX_CAMERAS)]
    return Judge(Device(args.device), seen, views, selected_options(args), on_render), len(every)
