"""The whole job on one machine: photos, poses, training, one compressed file, and back.

Without PHOTOS it makes photos itself and sets itself a bar: the exit code is 1 unless at least
95 % of them find their pose and the held-out views, rendered from the decoded file, reach 25 dB.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from outcome import Outcome, Target, gather, print_box, write_pages

from clgs.errors import ClgsError, DataError, DeviceError

STEPS = 1000
"""What two cores do in the time that the demo may take."""

OWN_TARGET = Target(registered=0.95, psnr=25.0)

LONG_SIDE = 640
"""Photos of a user are reduced for training until their long side is about this many pixels."""

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}
MARKER = ".clgs-demo"
MADE = ("data", "run", "renders", "scene.clgs", "decoded.npz", "scores.json")
"""What a run puts into the output folder, besides the marker, its photos and its pages."""


@dataclass
class Stages:
    """Runs the job stage by stage and keeps the seconds of each."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Announce stage ``name`` and take its time."""
        print(f"\n[{name}]", flush=True)
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start

    def clgs(self, name: str, *words: str | Path, quiet: bool = False) -> str:
        """Run one ``clgs`` command as stage ``name``; what it printed if ``quiet``, else "".

        Raises:
            SystemExit: it failed; it has said why, and its exit code is passed on.
        """
        # -P: the folder that the user stands in never shadows the installed package.
        command = [sys.executable, "-P", "-m", "clgs.cli.main", *map(str, words)]
        with self.timed(name):
            done = subprocess.run(
                command, stdout=subprocess.PIPE if quiet else None, text=True, check=False
            )
        if done.returncode:
            print(f"demo: stopped, {name} failed", file=sys.stderr)
            raise SystemExit(done.returncode)
        return done.stdout or ""


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
    doomed = [folder / name for name in (MADE if photos else (*MADE, "photos"))]
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


def survey(folder: Path) -> tuple[int, int]:
    """(number of photos in ``folder``, factor that brings them near LONG_SIDE).

    Raises:
        DataError: there is no photo.
    """
    from PIL import Image

    found = sorted(p for p in folder.glob("*") if p.suffix.lower() in SUFFIXES)
    if not found:
        raise DataError(f"{folder}: no photos found; name a folder with JPEG or PNG files")
    try:
        with Image.open(found[0]) as first:
            return len(found), max(1, round(max(first.size) / LONG_SIDE))
    except OSError as error:
        raise DataError(f"{found[0]}: not a readable photo ({error})") from None


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


def run(args: argparse.Namespace) -> Outcome:
    """All stages; the numbers."""
    device = choose_device(args.device)
    out: Path = args.output
    prepare_output(out, args.photos)
    stages = Stages()
    photos = args.photos or out / "photos"
    if args.photos is None:
        from photos import make_photos

        with stages.timed("photos"):
            print(f"{photos}: {make_photos(photos, args.seed)} photos", flush=True)
    count, downscale = survey(photos)
    data, trained, scene = out / "data", out / "run", out / "scene.clgs"
    decoded, renders, scores = out / "decoded.npz", out / "renders", out / "scores.json"
    on = ("--device", device)
    size = ("--downscale", str(downscale))
    plan = ("--preset", "quick", "--steps", str(args.steps), "--seed", str(args.seed))
    views = ("--data", data, "--split", "test", *size, *on)
    stages.clgs("prepare", "prepare", photos, "-o", data)
    stages.clgs("train", "train", data, "-o", trained, *plan, *size, *on)
    stages.clgs("encode", "encode", trained, "-o", scene)
    stages.clgs("decode", "decode", scene, "-o", decoded)
    stages.clgs("render", "render", decoded, *views, "-o", renders)
    stages.clgs("eval", "eval", scene, *views, "--json", scores, quiet=True)
    info = stages.clgs("info", "info", scene, "--json", quiet=True)
    with stages.timed("report"):
        outcome = gather(out, info, count, stages.seconds)
        write_pages(out, outcome)
    return outcome


def main(argv: list[str] | None = None) -> int:
    """Run the demonstration; the exit code."""
    args = parse(argv)
    try:
        outcome = run(args)
    except ClgsError as error:
        print(f"demo: error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    target = None if args.photos else OWN_TARGET
    print_box(outcome, args.output, target)
    return 1 if target and target.misses(outcome) else 0


if __name__ == "__main__":
    sys.exit(main())
