"""`clgs eval SCENE --data DATA`: scores of a scene against photos, and its fingerprint."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs.cli.options.view import add_view_options, named_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clgs.data.view import View
    from clgs.opencl.device import Device
    from clgs.options import RenderOptions
    from clgs.scene.scene import QuantizedScene, SplatScene
    from clgs.train.quality.score_views import Measure, ViewScore

STDOUT = Path("-")
"""What --json alone means."""

SHOWN = {
    "psnr": ("PSNR", "{:.2f} dB"),
    "psnr_channel_mean": ("PSNR, channel mean", "{:.2f} dB"),
    "ssim": ("SSIM", "{:.4f}"),
    "lpips": ("LPIPS", "{:.4f}"),
    "bytes": ("bytes", "{:,}"),
    "anchors": ("anchors", "{:,}"),
    "gaussians": ("Gaussians", "{:,}"),
}
"""What the table shows of the scores, and how."""

BASELINE = "Baseline"
"""What the survey's tables call the results that need no name beside the method's."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = (
        "Scores of a scene. psnr is that of 8-bit pictures, one MSE over all channels; "
        "psnr_channel_mean, the form of Voxel-GS's code, is the mean of the three channels' "
        "PSNRs, of the render before clamping. With --hashes: whether this process "
        "reproduces, bit for bit, the integers and renders that the trainer recorded (exit "
        "code 1 if not). SCENE may be an ordinary 3DGS PLY file, too, whose coordinates are "
        "those of its data set."
    )
    parser.add_argument(
        "scene", type=named_path, metavar="SCENE", help="run folder, .clgs or 3DGS .ply file"
    )
    add_view_options(parser)
    parser.add_argument(
        "--json",
        type=named_path,
        nargs="?",
        const=STDOUT,
        metavar="F",
        help="print the scores as JSON, not as a table; with F, write them, and each view's, to F",
    )
    parser.add_argument("--hashes", type=Path, metavar="F", help="hashes.json of the run")
    _add_family_options(parser)


def _add_family_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--lpips",
        type=named_path,
        metavar="F",
        help="LPIPS too (VGG, pictures in [0, 1]), with the weights in F, an .npz; needs the extra "
        "clgs[lpips]",
    )
    parser.add_argument(
        "--inria",
        type=named_path,
        metavar="DIR",
        help="write results.json and per_view.json to DIR as metrics.py of 3DGS does; PSNR is psnr",
    )
    parser.add_argument(
        "--csv",
        type=named_path,
        metavar="F",
        help="add a row to F, a table of the 3DGS compression survey; PSNR is psnr",
    )
    parser.add_argument(
        "--submethod",
        metavar="NAME",
        help=f"the first cell of the row of --csv (default: {BASELINE})",
    )


def run(args: argparse.Namespace) -> int:
    """Evaluate; exit code 0, or 1 if the hashes differ."""
    from clgs.cli.options.scene import read_drawable
    from clgs.cli.options.view import over_background
    from clgs.errors import UsageError
    from clgs.opencl.device import Device
    from clgs.scene.scene import SplatScene

    _check(args)
    lpips = _measure(args.lpips) if args.lpips else None
    scene, size = read_drawable(args.scene)
    if args.csv and size is None:
        raise UsageError(f"{args.scene}: has no size in bytes for --csv; name a .clgs file")
    device, code = Device(args.device), 0
    if args.hashes:
        if isinstance(scene, SplatScene):
            raise UsageError(f"{args.scene}: holds splats; --hashes are those of a trained run")
        code = _compare_hashes(device, scene, args.hashes)
    if args.data is not None:
        _score(args, device, over_background(args, scene), size, lpips)
    return code


def _check(args: argparse.Namespace) -> None:
    """Refuse what cannot be done, before long work; with --hashes alone there are no scores."""
    from clgs.cli.options.view import known_data, name_data
    from clgs.errors import UsageError

    named = [f"--{name}" for name in ("lpips", "inria", "csv") if getattr(args, name)]
    if args.data is None and known_data(args.scene) is None:
        if named:
            raise UsageError(f"{named[0]}: scores need photos; name them with --data")
        if args.hashes is None:
            name_data(args)  # it says why there are none
    elif args.data is None and (args.hashes is None or named or args.json):
        name_data(args)
    if args.submethod is not None and not (args.csv and args.submethod.isprintable()):
        raise UsageError("--submethod: names a row of --csv, in printable characters")
    _check_outputs(args)


def _check_outputs(args: argparse.Namespace) -> None:
    from clgs.errors import UsageError
    from clgs.files import check_folder, check_output
    from clgs.train.quality.score_tables import FILES, check_survey

    sources = [path for path in (args.scene, args.hashes, args.lpips) if path]
    file = None if args.json == STDOUT else args.json
    for path, suffix, what in ((file, ".json", "scores are"), (args.csv, ".csv", "table is")):
        if path and path.suffix.lower() != suffix:
            raise UsageError(f"{path}: the {what} a {suffix} file; name it so")
    outputs = [path for path in (file, args.csv) if path]
    for path in outputs:
        check_output(path, *sources)
    if args.inria:
        check_folder(args.inria)
        if (args.inria / "config.toml").exists():
            raise UsageError(f"{args.inria}: is a run with scores of its own; name another folder")
        outputs += [args.inria / name for name in FILES]
        if file and file.resolve() in (path.resolve() for path in outputs[-2:]):
            raise UsageError(f"{file}: is written by --inria; choose another name")
    for path in outputs:
        if args.data is not None and path.exists() and _lies_in(path, args.data):
            raise UsageError(f"{path}: is a file of the data set; choose another output")
    if args.csv:
        check_survey(args.csv)


def _lies_in(path: Path, folder: Path) -> bool:
    return folder.resolve() in path.resolve().parents


def _measure(path: Path) -> Measure:
    from clgs.train.quality.lpips import Lpips
    from clgs.train.quality.lpips_weights import read_lpips_weights

    return Lpips(read_lpips_weights(path))


def _score(
    args: argparse.Namespace,
    device: Device,
    scene: QuantizedScene | SplatScene,
    size: int | None,
    lpips: Measure | None,
) -> None:
    from clgs.cli.options.view import selected_options, selected_views, split_of
    from clgs.cli.progress import bar
    from clgs.scene.scene import SplatScene
    from clgs.train.quality.score_views import evaluate_views, summarize

    views, options = selected_views(args, scene), selected_options(args)
    with bar(len(views), "evaluating") as advance:
        scores = evaluate_views(device, scene, views, lambda *_: advance(), options, lpips)
    summary = summarize(scene, scores, size)
    if args.csv and "gaussians" not in summary:
        assert not isinstance(scene, SplatScene)
        summary["gaussians"] = _count_gaussians(device, scene, views, options)
    summary |= {
        "accuracy": options.accuracy.name,
        "split": split_of(args),
        "device": device.name,
    }
    if args.json == STDOUT:
        print(json.dumps(summary, indent=1))
    else:
        _show(summary)
    _write(args, summary, scores)


def _show(summary: dict[str, Any]) -> None:
    """The table for people."""
    rows = [("views", f"{summary['views']} ({summary['split']})")]
    for name, (title, form) in SHOWN.items():
        if summary.get(name) is not None:
            rows.append((title, form.format(summary[name])))
    width = max(len(title) for title, _ in rows)
    for title, text in rows:
        print(f"{title:<{width}}  {text}")


def _count_gaussians(
    device: Device, scene: QuantizedScene, views: Sequence[View], options: RenderOptions
) -> int:
    from clgs.cli.progress import bar
    from clgs.train.quality.drawn import count_drawn

    with bar(len(views), "counting Gaussians") as advance:
        return count_drawn(device, scene, [view.camera for view in views], options, advance)


def _write(args: argparse.Namespace, summary: dict[str, Any], scores: Sequence[ViewScore]) -> None:
    from clgs.cli.options.view import trained_steps
    from clgs.files import write_json
    from clgs.train.quality.score_tables import append_survey, write_inria

    if args.json not in (None, STDOUT):
        write_json(args.json, summary | {"per_view": [score.record() for score in scores]})
    if args.inria:
        steps = trained_steps(args.scene)
        write_inria(args.inria, "ours" if steps is None else f"ours_{steps}", summary, scores)
    if args.csv:
        name = BASELINE if args.submethod is None else args.submethod
        append_survey(args.csv, name, summary)


def _compare_hashes(device: Device, scene: QuantizedScene, path: Path) -> int:
    from clgs.train.state.hashes import differences, read_fingerprint

    found = differences(device, scene, read_fingerprint(path))
    print(f"hashes: {'all equal' if not found else 'DIFFERENT: ' + ', '.join(found)}")
    return 1 if found else 0
