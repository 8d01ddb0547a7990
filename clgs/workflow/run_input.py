"""What `clgs run` is given: photos, a video, or a data set."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from clgs.data.dataset import load_dataset
from clgs.data.photo_set import TRANSFORMS, is_posed
from clgs.errors import DataError
from clgs.poses.bring_in import find_source, readable_sizes
from clgs.poses.video import frame_size
from clgs.train.config.settings import BLENDER
from clgs.workflow.run_plan import Photos
from clgs.workflow.scenes import PLAN


@dataclass(frozen=True)
class RunInput:
    """What a run begins with.

    Attributes:
        path: as the user named it.
        posed: whether it is a data set, so that no poses have to be found.
        photos: their number and size.
        pointless: whether it is a data set without points, which are found before training.
        video: whether the photos are frames of a video.
        digest: changes if photos are added, removed or replaced; "" for a data set.
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


def find_input(path: Path) -> RunInput:
    """Look at ``path``.

    Raises:
        DataError: there is nothing that can be trained on.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file or folder; name photos, a video or a data set")
    if (path / PLAN).is_file():
        raise DataError(f"{path}: was made by clgs run; name the photos or the data set")
    if is_posed(path):
        return RunInput(path, True, measure_data(path), (path / TRANSFORMS).is_file())
    found = find_source(path)
    listed = [f"{file.name}\0{file.stat().st_size}" for file in found.files]
    names = "\n".join(listed).encode("utf-8", "surrogateescape")
    digest = hashlib.blake2b(names).hexdigest()[:32]
    if found.collection is None:
        photos = Photos(found.frames, *frame_size(path))
        return RunInput(path, False, photos, video=True, digest=digest)
    sizes = readable_sizes(found.collection)
    return RunInput(path, False, Photos(len(sizes), *sizes[0]), digest=digest)


def measure_data(folder: Path) -> Photos:
    """Number and size of the photos of a data set."""
    dataset = load_dataset(folder, max_size=0, load_images=False)
    first = dataset.train[0].camera
    count = len(dataset.train) + len(dataset.test)
    return Photos(count, first.width, first.height, dataset.kind == BLENDER)
