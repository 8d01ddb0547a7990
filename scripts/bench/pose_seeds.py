"""Poses of the same photos against each other: pose_seeds.py PREPARED PREPARED [--data DATA].

PREPARED is what `clgs prepare PHOTOS -o PREPARED --seed N` made, by two seeds. DATA is a data set
with known poses of the photos. Prints what each verdict says, how long it took, and by how many
degrees rotations differ at most once both worlds lie on each other: of the photos that are good in
both, and, in brackets, of all.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from clgs.data.dataset import load_dataset
from clgs.errors import ClgsError
from clgs.poses.judging.agreement import Poses, differences
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, Verdict, verdict_of


def main() -> None:
    """Print a line for each folder, and one for each pair."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prepared", type=Path, nargs=2)
    parser.add_argument("--data", type=Path)
    args = parser.parse_args()
    verdicts = [read_verdict(folder) for folder in args.prepared]
    poses = [read_poses(folder) for folder in args.prepared]
    for folder, verdict in zip(args.prepared, verdicts, strict=True):
        print(f"{folder}: {summary(verdict)}")
    good = [good_names(verdict) for verdict in verdicts]
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


def read_poses(folder: Path) -> Poses:
    """Read the poses of a data set by the photos' names without folder and suffix."""
    try:
        dataset = load_dataset(folder, load_images=False)
    except ClgsError as error:
        raise SystemExit(str(error)) from None
    views = [*dataset.train, *dataset.test]
    cameras = {Path(view.name).stem: view.camera for view in views}
    if len(cameras) < len(views):
        raise SystemExit(f"{folder}: photos in several folders share names; rename them")
    names = sorted(cameras)
    rotations = np.array([cameras[name].rotation for name in names])
    centres = np.array([cameras[name].centre for name in names])
    return Poses(names, rotations, centres, np.ones(len(names)))


def good_names(verdict: Verdict) -> set[str]:
    """Names of the photos that are neither doubtful nor left out."""
    return {Path(photo.name).stem for photo in verdict.of(GOOD)}


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


if __name__ == "__main__":
    main()
