"""Verdicts on poses against known ones: pose_subsets.py DATA PHOTOS EVERY [CHANGE] [--seed N].

DATA is a data set with the true poses, PHOTOS the folder of its photos, of which every EVERY-th is
prepared as if its pose were not known. CHANGE: tiny (a sixth of the size), blur (every third, by 4
pixels), light (every second at 0.45, the others at 1.15 times the brightness, with noise), turn
(every second lies on its side). Prints how many photos have which verdict, and how many are off by
more than a degree once both worlds lie on each other.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageFilter

from clgs.data.dataset import load_dataset
from clgs.poses.judging.agreement import Poses, differences
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT
from clgs.poses.prepare import prepare
from clgs.scene.camera import Camera

CHANGES = ("none", "tiny", "blur", "light", "turn")
WRONG = 1.0
"""Degrees of turn."""

QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""The rotation of a camera whose photo is turned a quarter to the left."""


def main() -> None:
    """Print one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("every", type=int)
    parser.add_argument("change", nargs="?", default="none", choices=CHANGES)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        chosen, made = Path(folder) / "photos", Path(folder) / "data"
        chosen.mkdir()
        names = copy_photos(args.photos, args.every, args.change, chosen)
        verdict = prepare(chosen, made, args.seed)
        truth = known_poses(args.data, args.photos.name, names)
        turns = {
            Path(name).name: one.turn
            for name, one in differences(truth, known_poses(made, "images", {})).items()
        }
    missing = {photo.name for photo in verdict.of(GOOD)} - set(turns)
    if missing:
        raise SystemExit(f"{args.data}: no pose is known of {', '.join(sorted(missing))}")
    counts = []
    for status in (GOOD, DOUBTFUL, LEFT_OUT):
        found = [photo.name for photo in verdict.of(status)]
        wrong = sum(turns.get(name, 0.0) > WRONG for name in found)
        counts.append(f"{len(found)} {status}" + (f" ({wrong} wrong)" if wrong else ""))
    largest = max((turns.get(photo.name, 0.0) for photo in verdict.of(GOOD)), default=0.0)
    print(f"{', '.join(counts)}; good ones off by at most {largest:.2f} degrees; {verdict.sure}")


def copy_photos(source: Path, every: int, change: str, target: Path) -> dict[str, bool]:
    """Copy photos, changed; whether each was turned, by its new name."""
    paths = sorted(path for path in source.iterdir() if path.suffix.lower() in (".jpg", ".png"))
    turned = {}
    for number, path in enumerate(paths[::every]):
        name = f"{path.stem}.png"
        with Image.open(path) as photo:
            changed(photo, change, number).save(target / name)
        turned[name] = change == "turn" and number % 2 == 1
    return turned


def changed(photo: Image.Image, change: str, number: int) -> Image.Image:
    """The photo of this number as it is prepared."""
    if change == "tiny":
        return photo.resize((photo.width // 6, photo.height // 6), Image.Resampling.LANCZOS)
    if change == "blur" and number % 3 == 0:
        return photo.filter(ImageFilter.GaussianBlur(4))
    if change == "turn" and number % 2:
        return photo.transpose(Image.Transpose.ROTATE_90)
    return lit(photo, number) if change == "light" else photo.copy()


def lit(photo: Image.Image, number: int) -> Image.Image:
    """Darker or brighter, with the noise of a bad sensor."""
    pixels: npt.NDArray[np.float64] = np.asarray(photo.convert("RGB"), np.float64)
    noise = np.random.default_rng(number).normal(0.0, 12.0, (photo.height, photo.width, 1))
    pixels = pixels * (0.45 if number % 2 else 1.15) + noise
    return Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8))


def known_poses(data: Path, folder: str, turned: Mapping[str, bool]) -> Poses:
    """Poses of a data set's photos in ``folder``; of those of ``turned`` alone, if it has any."""
    dataset = load_dataset(data, load_images=False)
    cameras: dict[str, Camera] = {}
    for view in [*dataset.train, *dataset.test]:
        path = Path(view.name)
        if path.parent.name in ("", folder):
            cameras[f"{path.stem}.png"] = view.camera
    names = sorted(set(cameras) & set(turned) if turned else cameras)
    rotations = [
        (QUARTER if turned.get(name) else np.eye(3)) @ cameras[name].rotation for name in names
    ]
    centres = np.array([cameras[name].centre for name in names])
    return Poses(names, np.array(rotations), centres, np.ones(len(names)))


if __name__ == "__main__":
    main()
