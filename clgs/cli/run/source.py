"""What `clgs run` is given: photos, a video, or a data set; and how much of it there is."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from clgs.cli.run.plan import Photos
from clgs.errors import DataError

PLAN = "plan.json"
"""What an output folder is known by: the plan of the run that made it."""


@dataclass(frozen=True)
class Source:
    """What a run begins with.

    path: as named; posed: whether it is a data set, so that no poses have to be found; pointless:
    a data set without points, which are found before training; video: the photos are its frames;
    digest: of the names and sizes of the files, if poses are to be found.
    """

    path: Path
    posed: bool
    photos: Photos
    pointless: bool = False
    video: bool = False
    digest: str = ""

    @property
    def complete(self) -> bool:
        """Whether there are poses and points."""
        return self.posed and not self.pointless


def run_folder(scene: Path) -> Path:
    """The run folder that ``scene`` is, or lies in; of the output of `clgs run`, the one below."""
    folder = scene if scene.is_dir() else scene.parent
    below = folder / "run"
    return below if (folder / PLAN).is_file() and below.is_dir() else folder


def find_source(path: Path) -> Source:
    """Look at ``path``.

    Raises:
        DataError: there is nothing that can be trained on.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file or folder; name photos, a video or a data set")
    if (path / PLAN).is_file():
        raise DataError(f"{path}: was made by clgs run; name the photos or the data set")
    if path.is_dir() and _is_data(path):
        pointless = (path / "transforms.json").is_file()
        return Source(path, True, measure_data(path), pointless)
    return _measure_photos(path)


def measure_data(folder: Path) -> Photos:
    """Number and size of the photos of a data set."""
    from clgs.data.dataset import load_dataset
    from clgs.train.config.settings import BLENDER

    dataset = load_dataset(folder, max_size=0, load_images=False)
    first = dataset.train[0].camera
    count = len(dataset.train) + len(dataset.test)
    return Photos(count, first.width, first.height, dataset.kind == BLENDER)


def _is_data(folder: Path) -> bool:
    from clgs.data.colmap.model import find_model

    named = ("transforms_train.json", "transforms.json")
    return any((folder / name).is_file() for name in named) or find_model(folder) is not None


def _measure_photos(path: Path) -> Source:
    from clgs.poses.photos.bring_in import find_source as find_photos
    from clgs.poses.photos.bring_in import readable_sizes
    from clgs.poses.photos.video import frame_size

    found = find_photos(path)
    digest = _digest(found.files)
    if found.collection is None:
        return Source(
            path, False, Photos(found.frames, *frame_size(path)), video=True, digest=digest
        )
    sizes = readable_sizes(found.collection)
    return Source(path, False, Photos(len(sizes), *sizes[0]), digest=digest)


def _digest(files: list[Path]) -> str:
    """By which it is seen that photos were added, taken away or replaced; none is read."""
    listed = [f"{path.name}\0{path.stat().st_size}" for path in files]
    return hashlib.blake2b("\n".join(listed).encode("utf-8", "surrogateescape")).hexdigest()[:32]
