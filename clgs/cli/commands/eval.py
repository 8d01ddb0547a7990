"""`clgs eval SCENE --data DATA`: scores of a scene against photos, and its fingerprint."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options.view import add_view_options

if TYPE_CHECKING:
    from clgs.opencl.device import Device
    from clgs.scene.scene import QuantizedScene


def register(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        "eval",
        help="PSNR and SSIM against the photos",
        description="Scores of a scene. With --hashes: whether this process reproduces, bit for "
        "bit, the integers and renders that the trainer recorded (exit code 1 if not).",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="run folder or .clgs file")
    add_view_options(parser, data_required=False)
    parser.add_argument("--json", type=Path, metavar="F", help="write the scores to F")
    parser.add_argument("--hashes", type=Path, metavar="F", help="hashes.json of the run")


def run(args: argparse.Namespace) -> int:
    """Evaluate; exit code 0, or 1 if the hashes differ."""
    from clgs.cli.options.scene import read_scene
    from clgs.errors import UsageError
    from clgs.files import check_output
    from clgs.opencl.device import Device

    if args.data is None and args.hashes is None:
        raise UsageError("nothing to do: name the photos with --data, or hashes with --hashes")
    if args.json:
        if args.json.suffix.lower() != ".json":
            raise UsageError(f"{args.json}: the scores are a .json file; name it so")
        check_output(args.json, args.scene, *([args.hashes] if args.hashes else []))
        if args.data is not None and args.json.exists() and _lies_in(args.json, args.data):
            raise UsageError(f"{args.json}: is a file of the data set; choose another output")
    scene, size = read_scene(args.scene)
    device = Device(args.device)
    code = _compare_hashes(device, scene, args.hashes) if args.hashes else 0
    if args.data is not None:
        _score(args, device, scene, size)
    return code


def _lies_in(path: Path, folder: Path) -> bool:
    return folder.resolve() in path.resolve().parents


def _score(
    args: argparse.Namespace, device: Device, scene: QuantizedScene, size: int | None
) -> None:
    from clgs.cli.options.view import selected_options, selected_views
    from clgs.cli.progress import bar
    from clgs.train.quality.score_views import evaluate_views, summarize
    from clgs.train.run.session import write_json

    views, options = selected_views(args, scene), selected_options(args)
    with bar(len(views), "evaluating") as advance:
        scores = evaluate_views(device, scene, views, lambda *_: advance(), options)
    summary = summarize(scene, scores, size)
    summary |= {
        "accuracy": options.accuracy.name,
        "split": args.split,
        "device": device.name,
    }
    print(json.dumps(summary, indent=1))
    if args.json:
        write_json(args.json, summary | {"per_view": [score.record() for score in scores]})


def _compare_hashes(device: Device, scene: QuantizedScene, path: Path) -> int:
    from clgs.train.state.hashes import differences, read_fingerprint

    found = differences(device, scene, read_fingerprint(path))
    print(f"hashes: {'all equal' if not found else 'DIFFERENT: ' + ', '.join(found)}")
    return 1 if found else 0
