"""The whole job on one machine: `clgs run` of photos that the demonstration makes itself.

It sets itself a bar: the exit code is 1 unless at least 95 % of the photos find their pose and the
held-out views, rendered from the file, reach 25 dB. With PHOTOS it is `clgs run PHOTOS`, no more.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from picture import draw_showcase
from PIL import Image

from clgs.cli.main import main as clgs
from clgs.data.images import list_images
from clgs.errors import ClgsError, DataError, DeviceError
from clgs.exports.pictures import picture_names, save_png
from clgs.exports.report import sections
from clgs.workflow.runs.record import measure_data

STEPS = 1000
"""What two cores do in the time that the demo may take."""

LEAST_REGISTERED, LEAST_PSNR = 0.95, 25.0
"""Share of the photos that must find their pose, and PSNR in dB."""

MAX_SIZE = 640
"""Wider photos of a user are reduced to this width."""

MARKER = ".clgs-demo"
MADE = ("photos", "scene", "comparison.png")
"""What a run puts into the output folder, in addition to the marker."""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument("photos", nargs="?", type=Path, help="folder of photos (default: own)")
    parser.add_argument("--steps", type=int, default=STEPS, help=f"of training (default: {STEPS})")
    parser.add_argument("--output", type=Path, default=Path("demo_output"), metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", help="default: PoCL if there is one, see `clgs devices`")
    return parser.parse_args(argv)


def prepare_output(folder: Path, photos: Path | None) -> None:
    """An output folder without the results of an earlier demo; foreign files are never touched.

    Raises:
        DataError: the folder holds something that is not a demo's, or the photos would be lost.
    """
    marker = folder / MARKER
    if folder.exists() and not marker.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError(f"{folder}: exists and is not a demo's output; choose another --output")
    doomed = [folder / name for name in (MADE[1:] if photos else MADE)]
    if photos and any(photos.resolve().is_relative_to(path.resolve()) for path in doomed):
        raise DataError(
            f"{photos}: lies in the folder that the demo writes to; choose another --output"
        )
    folder.mkdir(parents=True, exist_ok=True)
    marker.touch()
    for path in doomed:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def choose_device(name: str | None) -> str:
    """The name of the device to run on: ``name``, else PoCL, else the usual choice."""
    from clgs.opencl.choose import choose_device as choose

    try:
        chosen = choose(name or "portable computing language")
    except DeviceError:
        if name:
            raise
        chosen = choose()
    return str(chosen.name)


def run(args: argparse.Namespace) -> int:
    """Photos, `clgs run`, and the picture; the exit code."""
    device, out = choose_device(args.device), args.output
    prepare_output(out, args.photos)
    photos = args.photos or out / "photos"
    if args.photos is None:
        from photos import make_photos

        print(f"{photos}: {make_photos(photos, args.seed)} photos", flush=True)
    plan = ("--steps", str(args.steps), "--max-size", str(MAX_SIZE), "--seed", str(args.seed))
    code = clgs(["run", str(photos), "-o", str(out / "scene"), *plan, "--device", device])
    if code:
        return code
    scores = json.loads((out / "scene" / "scores.json").read_text(encoding="utf-8"))
    draw_comparison(out / "comparison.png", out / "scene" / "run", scores["per_view"])
    if args.photos is not None:
        return 0
    registered = measure_data(out / "scene" / "data").count
    short = misses(registered, len(list_images(photos)), scores["psnr"])
    for miss in short:
        print(f"demo: short of its target: {miss}", file=sys.stderr)
    return 1 if short else 0


def misses(registered: int, photos: int, psnr: float) -> list[str]:
    """What falls short of the demo's own bar, in words; a PSNR that is not a number does too."""
    found = []
    if not registered >= LEAST_REGISTERED * photos:
        share = f"{registered} of {photos}"
        found.append(f"{share} photos found their pose, {LEAST_REGISTERED:.0%} are needed")
    if not psnr >= LEAST_PSNR:
        found.append(f"held-out PSNR {psnr:.2f} dB, below {LEAST_PSNR:g} dB")
    return found


def draw_comparison(path: Path, run: Path, scores: list[dict[str, Any]]) -> None:
    """Draw the held-out view of median PSNR, neither the best nor the worst, and the file's bytes.

    run: the run folder; scores: of the views, as ``clgs eval --json`` writes them.
    """
    names = picture_names([score["name"] for score in scores])
    ranked = sorted(zip(scores, names, strict=True), key=lambda pair: float(pair[0]["psnr"]))
    score, name = ranked[len(ranked) // 2]
    pictures = []
    for kind in ("gt", "renders"):
        found = next((run / "test").glob(f"*/{kind}/{name}"), None)
        if found is None:
            raise DataError(f"{run / 'test'}: no picture {name}; run the demo again")
        with Image.open(found) as picture:
            pictures.append(np.array(picture.convert("RGB")))
    save_png(path, draw_showcase(*pictures, score["psnr"], sections(run)))


def main(argv: list[str] | None = None) -> int:
    """Run the demonstration; the exit code."""
    args = parse(argv)
    try:
        return run(args)
    except ClgsError as error:
        print(f"demo: error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
