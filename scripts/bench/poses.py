"""Verdicts of `clgs prepare` on poses, measured.

``poses.py seeds PREPARED PREPARED [--data DATA]``: the same photos, prepared by two seeds. Prints
what each verdict says, how long it took, and by how many degrees rotations differ at most once both
worlds lie on each other: of the photos that are good in both, and, in brackets, of all. DATA is a
data set with known poses of the photos.

``poses.py subset DATA PHOTOS EVERY [CHANGE] [--seed N]``: every EVERY-th photo of the folder PHOTOS
is prepared as if its pose in the data set DATA were not known. CHANGE: tiny (a sixth of the size),
blur (every third, by 4 pixels), light (every second at 0.45, the others at 1.15 times the
brightness, with noise), turn (every second lies on its side). Prints how many photos have which
verdict, and how many are off by more than a degree.

``poses.py recall PHOTOS EVERY``: all pairs of every EVERY-th photo of a folder, matched by all
their features and verified. Prints how many of the verified pairs pass the cheap look, which leaves
pairs out before that, and the most matches of one that does not.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageFilter

from clgs.data.dataset import load_dataset
from clgs.errors import ClgsError
from clgs.opencl.device import Device
from clgs.poses.evidence import Poses, differences
from clgs.poses.prepare import prepare
from clgs.poses.pycolmap_child import quiet_pycolmap
from clgs.poses.stages import matching
from clgs.poses.stages.features import extract
from clgs.poses.verdict import DOUBTFUL, GOOD, LEFT_OUT, Verdict, verdict_of
from clgs.poses.workspace import Workspace
from clgs.scene.camera import Camera

CHANGES = ("none", "tiny", "blur", "light", "turn")
PHOTOS = (".jpg", ".jpeg", ".png")
WRONG = 1.0
"""Degrees of turn."""

QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""The rotation of a camera whose photo is turned a quarter to the left."""


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = parser.add_subparsers(required=True)
    seeds = kinds.add_parser("seeds")
    seeds.add_argument("prepared", type=Path, nargs=2)
    seeds.add_argument("--data", type=Path)
    seeds.set_defaults(run=compare_seeds)
    subset = kinds.add_parser("subset")
    subset.add_argument("data", type=Path)
    subset.add_argument("photos", type=Path)
    subset.add_argument("every", type=int)
    subset.add_argument("change", nargs="?", default="none", choices=CHANGES)
    subset.add_argument("--seed", type=int, default=0)
    subset.set_defaults(run=judge_subset)
    recall = kinds.add_parser("recall")
    recall.add_argument("photos", type=Path)
    recall.add_argument("every", type=int)
    recall.set_defaults(run=count_recalled)
    args = parser.parse_args()
    try:
        args.run(args)
    except ClgsError as error:
        raise SystemExit(str(error)) from None


def compare_seeds(args: argparse.Namespace) -> None:
    """Print a line for each folder, and one for each pair."""
    verdicts = [read_verdict(folder) for folder in args.prepared]
    poses = [read_poses(folder) for folder in args.prepared]
    for folder, verdict in zip(args.prepared, verdicts, strict=True):
        print(f"{folder}: {summary(verdict)}")
    good = [{Path(photo.name).stem for photo in verdict.of(GOOD)} for verdict in verdicts]
    print(f"between them: {apart(*poses, good[0] & good[1])}")
    if args.data is not None:
        known = read_poses(args.data)
        for folder, own, names in zip(args.prepared, poses, good, strict=True):
            print(f"{folder} against {args.data}: {apart(own, known, names)}")


def read_verdict(folder: Path) -> Verdict:
    """Read the verdict that `clgs prepare` wrote."""
    path = folder / "report.json"
    try:
        return verdict_of(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        raise SystemExit(
            f"{path}: no report of `clgs prepare`; name a folder that it made"
        ) from None


def read_poses(
    folder: Path, photos: str | None = None, turned: Mapping[str, bool] | None = None
) -> Poses:
    """Read the poses of a data set by the photos' names without folder and suffix.

    photos: the folder of the photos that count; None: all do. turned: only the photos of these
    names, each turned by a quarter if it says so.
    """
    dataset = load_dataset(folder, load_images=False)
    cameras: dict[str, Camera] = {}
    for view in [*dataset.train, *dataset.test]:
        path = Path(view.name)
        if photos and path.parent.name not in ("", photos):
            continue
        if path.stem in cameras:
            raise SystemExit(f"{folder}: photos in several folders share names; rename them")
        if turned is None or path.stem in turned:
            cameras[path.stem] = view.camera
    names = sorted(cameras)
    rotations = [
        (QUARTER if turned and turned[name] else np.eye(3)) @ cameras[name].rotation
        for name in names
    ]
    centres = np.array([cameras[name].centre for name in names])
    return Poses(names, np.array(rotations), centres, np.ones(len(names)))


def summary(verdict: Verdict) -> str:
    """Counts, error, seconds and how sure the poses are."""
    doubtful, left_out = (len(verdict.of(status)) for status in (DOUBTFUL, LEFT_OUT))
    return (
        f"{verdict.registered} of {verdict.total} with a pose, {doubtful} doubtful, "
        f"{left_out} left out; {verdict.error:.2f} px, {sum(verdict.seconds.values()):.0f} s; "
        f"{verdict.sure}"
    )


def apart(first: Poses, second: Poses, good: set[str]) -> str:
    """The largest and the median turn of the photos in ``good``, and the largest of all."""
    turns = {name: one.turn for name, one in differences(first, second).items()}
    counted = [turns[name] for name in good & turns.keys()]
    if not counted:
        return f"none of {len(turns)} common photos is good in both"
    return (
        f"{len(counted)} good ones of {len(turns)} common photos differ by at most "
        f"{max(counted):.3f} degrees, median {np.median(counted):.3f} "
        f"(all: {max(turns.values()):.3f})"
    )


def judge_subset(args: argparse.Namespace) -> None:
    """Prepare some photos, changed, and print one line."""
    with tempfile.TemporaryDirectory() as folder:
        chosen, made = Path(folder) / "photos", Path(folder) / "data"
        chosen.mkdir()
        turned = copy_photos(args.photos, args.every, args.change, chosen)
        verdict = prepare(chosen, made, args.seed)
        truth = read_poses(args.data, args.photos.name, turned)
        turns = {name: one.turn for name, one in differences(truth, read_poses(made)).items()}
    names = {
        status: [Path(photo.name).stem for photo in verdict.of(status)]
        for status in (GOOD, DOUBTFUL, LEFT_OUT)
    }
    if missing := set(names[GOOD]) - set(turns):
        raise SystemExit(f"{args.data}: no pose is known of {', '.join(sorted(missing))}")
    counts = []
    for status, found in names.items():
        wrong = sum(turns.get(name, 0.0) > WRONG for name in found)
        counts.append(f"{len(found)} {status}" + (f" ({wrong} wrong)" if wrong else ""))
    largest = max((turns[name] for name in names[GOOD]), default=0.0)
    print(f"{', '.join(counts)}; good ones off by at most {largest:.2f} degrees; {verdict.sure}")


def copy_photos(source: Path, every: int, change: str, target: Path) -> dict[str, bool]:
    """Copy photos, changed; whether each was turned, by its name without suffix."""
    if every < 1 or not source.is_dir():
        raise SystemExit(f"{source}: name a folder, and every which of its photos, 1 or more")
    paths = sorted(path for path in source.iterdir() if path.suffix.lower() in PHOTOS)
    if not paths[every::every]:
        raise SystemExit(f"{source}: two photos are needed, {' or '.join(PHOTOS)}")
    turned = {}
    for number, path in enumerate(paths[::every]):
        with Image.open(path) as photo:
            changed(photo, change, number).save(target / f"{path.stem}.png")
        turned[path.stem] = change == "turn" and number % 2 == 1
    return turned


def changed(photo: Image.Image, change: str, number: int) -> Image.Image:
    """The photo of this number as it is prepared."""
    if change == "tiny":
        return photo.resize((photo.width // 6, photo.height // 6), Image.Resampling.LANCZOS)
    if change == "blur" and number % 3 == 0:
        return photo.filter(ImageFilter.GaussianBlur(4))
    if change == "turn" and number % 2:
        return photo.transpose(Image.Transpose.ROTATE_90)
    if change == "light":  # darker or brighter, with the noise of a bad sensor
        pixels: npt.NDArray[np.float64] = np.asarray(photo.convert("RGB"), np.float64)
        noise = np.random.default_rng(number).normal(0.0, 12.0, (photo.height, photo.width, 1))
        pixels = pixels * (0.45 if number % 2 else 1.15) + noise
        return Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8))
    return photo.copy()


def count_recalled(args: argparse.Namespace) -> None:
    """Match photos with and without the cheap look, and print one line."""
    with tempfile.TemporaryDirectory() as folder, quiet_pycolmap("recall") as pycolmap:
        images = Path(folder) / "images"
        images.mkdir()
        names = [f"{stem}.png" for stem in copy_photos(args.photos, args.every, "none", images)]
        longest = max(max(Image.open(images / name).size) for name in names)
        workspace = Workspace(
            pycolmap,
            Device(),
            images,
            Path(folder),
            names,
            [0] * len(names),
            seed=0,
            on_progress=lambda stage, done, total: None,
        )
        extract(workspace, longest, quick=False)
        pairs = list(combinations(range(len(names)), 2))
        passed = set(matching.pairs_alike(workspace, pairs))
        with patch.object(matching, "pairs_alike", lambda workspace, pairs: pairs):
            matching.match(workspace, pairs, matching.MAX_DESCRIPTORS)
        with workspace.open() as database:
            place = {number: place for place, number in enumerate(workspace.ids(database))}
        verified = {
            (place[pair.first], place[pair.second]): len(pair.matches)
            for pair in matching.read_evidence(workspace).pairs
        }
    if not verified:
        raise SystemExit(f"{args.photos}: no two photos could be matched")
    missed = sorted(verified[pair] for pair in verified.keys() - passed)
    print(
        f"{len(names)} photos, {len(pairs)} pairs: {len(passed)} pass; of {len(verified)} that are "
        f"verified {len(verified) - len(missed)} do ({1 - len(missed) / len(verified):.4f}); the "
        f"others have at most {max(missed, default=0)} matches"
    )


if __name__ == "__main__":
    main()
