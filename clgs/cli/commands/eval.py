"""`clgs eval SCENE --data DATA`: scores of a scene against photos, and its fingerprint."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    AS_TRAINED,
    add_masks,
    add_overwrite,
    add_test_every,
    add_view_options,
    named_path,
    view_options,
)

if TYPE_CHECKING:
    from clgs.workflow.options import ViewOptions
    from clgs.workflow.views import Evaluation

STDOUT = Path("-")
"""The value of --json without a file."""

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
"""The name that the survey's tables give to results without a name of their own."""


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
    add_view_options(parser)
    add_masks(parser, AS_TRAINED)
    add_test_every(parser)
    parser.add_argument(
        "--json",
        type=named_path,
        nargs="?",
        const=STDOUT,
        metavar="F",
        help="print the scores as JSON, not as a table; with F, write them, and each view's, to F",
    )
    parser.add_argument("--hashes", type=Path, metavar="F", help="hashes.json of the run")
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
    add_overwrite(parser, "files of --json and --inria that exist (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Evaluate; exit code 0, or 1 if the hashes differ."""
    from clgs.cli.display import Display
    from clgs.errors import UsageError
    from clgs.files import write_json
    from clgs.opencl.device import Device
    from clgs.scene.scene import SplatScene
    from clgs.train.quality.lpips import Lpips, read_lpips_weights
    from clgs.train.quality.scores import append_survey, write_inria
    from clgs.train.state.hashes import differences, read_fingerprint
    from clgs.workflow.scenes import read_drawable
    from clgs.workflow.views import evaluate, trained_config

    given = ("lpips", "inria", "csv", "json")
    tables = [f"--{name}" for name in given if getattr(args, name)]
    views = view_options(vars(args))
    views = _scored_views(args.scene, views, args.hashes is not None, tables)
    if args.submethod is not None and not (args.csv and args.submethod.isprintable()):
        raise UsageError("--submethod: names a row of --csv, in printable characters")
    sources = [path for path in (args.scene, args.hashes, args.lpips) if path]
    file = None if args.json == STDOUT else args.json
    _check_outputs(file, args.csv, args.inria, sources, views.data)
    _check_free(file, args.inria, args.overwrite)
    lpips = Lpips(read_lpips_weights(args.lpips)) if args.lpips else None
    scene, size = read_drawable(args.scene)
    if args.csv and size is None:
        raise UsageError(f"{args.scene}: has no size in bytes for --csv; name a .clgs file")
    device, code = Device(args.device), 0
    if args.hashes:
        if isinstance(scene, SplatScene):
            raise UsageError(f"{args.scene}: holds splats; --hashes are those of a trained run")
        found = differences(device, scene, read_fingerprint(args.hashes))
        print(f"hashes: {'all equal' if not found else 'DIFFERENT: ' + ', '.join(found)}")
        code = 1 if found else 0
    if views.data is None:
        return code
    with Display() as display:
        count = bool(args.csv)
        scored = evaluate(
            device,
            args.scene,
            scene,
            size,
            views,
            lpips=lpips,
            count_gaussians=count,
            on_event=display,
        )
    if args.json == STDOUT:
        print(json.dumps(scored.summary, indent=1))
    else:
        show(scored)
    if args.json not in (None, STDOUT):
        write_json(args.json, scored.record())
    if args.inria:
        config = trained_config(args.scene)
        method = "ours" if config is None else f"ours_{config.steps}"
        write_inria(args.inria, method, scored.summary, scored.scores)
    if args.csv:
        name = BASELINE if args.submethod is None else args.submethod
        append_survey(args.csv, name, scored.summary)
    return code


def show(scored: Evaluation) -> None:
    """Print the table of the scores."""
    summary = scored.summary
    rows = [("views", f"{summary['views']} ({summary['split']})")]
    for name, (title, form) in SHOWN.items():
        if summary.get(name) is not None:
            rows.append((title, form.format(summary[name])))
    width = max(len(title) for title, _ in rows)
    for title, text in rows:
        print(f"{title:<{width}}  {text}")


def _scored_views(scene: Path, views: ViewOptions, hashes: bool, tables: list[str]) -> ViewOptions:
    """The views that are scored, with the known data set if none is named; none for hashes alone.

    ``tables``: the options that need scores; --json comes last.

    Raises:
        UsageError: scores are needed, and the photos are not known.
    """
    from clgs.errors import UsageError
    from clgs.workflow.views import data_of, known_data

    if views.data is not None or (hashes and not tables):
        return views
    known = known_data(scene)
    if tables and tables != ["--json"] and known is None:
        raise UsageError(f"{tables[0]}: scores need photos; name them with --data")
    return views if hashes and known is None else replace(views, data=data_of(scene))


def _check_outputs(
    file: Path | None, csv: Path | None, inria: Path | None, sources: list[Path], data: Path | None
) -> None:
    """Refuse outputs that have a wrong name, are read, or belong to the data set or another run."""
    from clgs.errors import UsageError
    from clgs.files import check_folder, check_output
    from clgs.train.quality.scores import FILES, check_survey

    for path, suffix, what in ((file, ".json", "scores are"), (csv, ".csv", "table is")):
        if path and path.suffix.lower() != suffix:
            raise UsageError(f"{path}: the {what} a {suffix} file; name it so")
    outputs = [path for path in (file, csv) if path]
    for path in outputs:
        check_output(path, *sources)
    if inria:
        check_folder(inria)
        if (inria / "config.toml").exists():
            raise UsageError(f"{inria}: is a run with scores of its own; name another folder")
        outputs += [inria / name for name in FILES]
        if file and file.resolve() in (path.resolve() for path in outputs[-2:]):
            raise UsageError(f"{file}: is written by --inria; choose another name")
    for path in outputs:
        if data is not None and path.exists() and data.resolve() in path.resolve().parents:
            raise UsageError(f"{path}: is a file of the data set; choose another output")
    if csv:
        check_survey(csv)


def _check_free(file: Path | None, inria: Path | None, overwrite: bool) -> None:
    """Raise ExistsError if scores would replace a file; a row of --csv replaces nothing."""
    from clgs.train.quality.scores import FILES
    from clgs.workflow.outputs import check_new

    tables = [inria / name for name in FILES] if inria else []
    for path in [*([file] if file else []), *tables]:
        if path.exists():
            check_new(path, overwrite)
