"""What `clgs run` is given, plans, keeps in its folder so that --resume continues, and makes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from clgs.data.dataset import Dataset, is_posed, load_dataset, read_photo_set
from clgs.data.masks import meaning_of
from clgs.errors import DataError, ExistsError, UsageError
from clgs.files import write_json
from clgs.poses.bring_in import find_source, readable_sizes
from clgs.poses.video import frame_size
from clgs.train.config.settings import BLENDER
from clgs.train.config.sources import find
from clgs.train.run.load import must_triangulate
from clgs.workflow.runs.plan import Photos, TrainingPlan
from clgs.workflow.scenes import PLAN

DATA = "data"
"""The data set in the output folder, if poses had to be found."""

RUN_OPTIONS = (
    *("steps", "max_size", "seed", "masks", "background"),
    *("size_lambda", "target_size", "max_anchors", "exposure"),
)
"""Settings of training that `clgs run` has options of their own for; it has --set for others."""

TRIED = 4
"""Photos whose features are found and matched before a run is planned."""

RUN = "run"
"""The run folder of training in the output folder."""


@dataclass(frozen=True)
class RunInput:
    """What a run begins with: the path as the user named it, and what it holds.

    posed: it is a data set, so that no poses have to be found; pointless: one without points, which
    are found before training; video: the photos are frames of one; digest: changes if photos are
    added, removed or replaced, "" for a data set; tried: photos that tell the time of all; largest:
    longer side of the largest photo, pixels.
    """

    path: Path
    posed: bool
    photos: Photos
    pointless: bool = False
    video: bool = False
    digest: str = ""
    tried: tuple[Path, ...] = ()
    largest: int = 0

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
        dataset = load_dataset(path, max_size=0, load_images=False)
        pointless = must_triangulate(dataset) and read_photo_set(path).points_file is None
        return RunInput(path, True, _photos_of(dataset), pointless)
    found = find_source(path)
    listed = [f"{file.name}\0{file.stat().st_size}" for file in found.files + found.masks]
    names = "\n".join(listed).encode("utf-8", "surrogateescape")
    digest = hashlib.blake2b(names).hexdigest()[:32]
    if found.collection is None:
        photos = Photos(found.frames, *frame_size(path))
        return RunInput(path, False, photos, video=True, digest=digest)
    sizes = readable_sizes(found.collection)
    masks = [one.mask for one in found.collection.photos]
    given, meaning = sum(mask is not None for mask in masks), meaning_of(masks)
    size = max(set(sizes), key=lambda one: (sizes.count(one), one))  # most photos have it
    photos = Photos(len(sizes), *size, masks=given, meaning=meaning)
    files = [one.path for one in found.collection.photos]
    around = len(sizes) != len(files)  # some are cut into views
    usual = [] if around else [file for file, one in zip(files, sizes, strict=True) if one == size]
    tried = tuple(usual[:: max(1, len(usual) // TRIED)][:TRIED])
    largest = max(max(one) for one in sizes)
    return RunInput(path, False, photos, digest=digest, tried=tried, largest=largest)


def measure_data(folder: Path) -> Photos:
    """Number and size of the photos of a data set."""
    return _photos_of(load_dataset(folder, max_size=0, load_images=False))


def _photos_of(dataset: Dataset) -> Photos:
    first = dataset.train[0].camera
    count = len(dataset.train) + len(dataset.test)
    masks = sum(view.mask is not None for view in dataset.train + dataset.test)
    meaning = meaning_of([photo.mask for photo in dataset.photos])
    return Photos(count, first.width, first.height, dataset.kind == BLENDER, masks, meaning)


@dataclass(frozen=True)
class RunRecord:
    """A run, as the file PLAN keeps it.

    Attributes:
        input: the absolute path that it began with.
        photos: their number there.
        digest: as in :class:`RunInput`.
        time: seconds that it was planned for.
        settings: of training; empty until it is planned.
        plan: the fields of the :class:`TrainingPlan`, and title and hurry.
        seconds: that each stage took, over all calls.
        made: bytes of the files that the stages made, by name.
    """

    input: str
    photos: int
    digest: str
    time: float
    settings: dict[str, Any] = field(default_factory=dict)
    plan: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    made: dict[str, int] = field(default_factory=dict)

    def write(self, out: Path) -> None:
        """Write the record into the folder ``out``."""
        write_json(out / PLAN, asdict(self))

    def check(
        self, out: Path, given: RunInput, seconds: float | None, settings: dict[str, Any]
    ) -> None:
        """See that this run in ``out`` has that input and settings; None is any.

        With another time than it was planned for, ``seconds``, it may have other settings.

        Raises:
            UsageError: it has others.
        """
        again = "start from the beginning with --overwrite"
        if self.input != str(given.path.resolve()):
            raise UsageError(f"{out}: is a run of {self.input}; name that, or another folder")
        if not self.settings and not (out / DATA).is_dir():
            return
        if self.photos != given.photos.count:
            count = given.photos.count
            raise UsageError(
                f"{given.path}: has {count} photo{'s' * (count != 1)}, and the run in {out} began "
                f"with {self.photos}; {again}"
            )
        if self.digest != given.digest:
            raise UsageError(
                f"{given.path}: holds other photos than the run in {out} began with; {again}"
            )
        if seconds not in (None, self.time):
            return
        for name, value in settings.items():
            if self.settings and value not in (None, self.settings.get(name)):
                option = find(name).flag if name in RUN_OPTIONS else f"--set {name}"
                shown = self.settings.get(name, "its default")
                raise UsageError(
                    f"{option}: the run in {out} has {shown}; leave it out, or {again}"
                )


@dataclass(frozen=True)
class RunPlan:
    """What `clgs run` is going to do on the device of that name, in ``allowed`` seconds.

    hurry: the poses are not tested, for lack of time.
    """

    input: RunInput
    training: TrainingPlan
    device: str
    hurry: bool
    allowed: float


@dataclass(frozen=True)
class FinishedRun:
    """What `clgs run` made in its output folder.

    photos: how many were used, in words; scores: as ``clgs eval --json`` writes them; seconds: by
    stage, over all calls that worked on the run; failures: of exports, by stage; sketch: what to do
    if there was little time to train, else empty.
    """

    folder: Path
    photos: str
    scores: dict[str, Any]
    seconds: dict[str, float]
    failures: dict[str, Exception]
    sketch: str = ""


def in_words(seconds: float) -> str:
    """A time such as 45 s, 2.5 min or 1.2 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def read_record(out: Path, resume: bool, overwrite: bool) -> RunRecord | None:
    """The run in ``out`` that is resumed; None if a run begins.

    Raises:
        DataError: its record is damaged.
        ExistsError: ``out`` holds other things, or a run that is neither resumed nor replaced.
        UsageError: options contradict each other.
    """
    path = out / PLAN
    if resume and overwrite:
        raise UsageError("--resume goes on with a run and --overwrite replaces it; give one")
    if not path.is_file():
        if (out / RUN / "config.toml").is_file():
            raise ExistsError(
                f"{out}: holds a run, but not its {PLAN}; finish {out / RUN} by `clgs train "
                "--resume`, or choose another folder"
            )
        if out.is_dir() and any(out.iterdir()):
            raise ExistsError(f"{out}: holds other files; choose another folder")
        return None
    if overwrite:
        return None
    if not resume:
        raise ExistsError(
            f"{out}: holds a run already; go on with it (--resume), replace it "
            "(--overwrite), or choose another folder"
        )
    try:
        found = RunRecord(**json.loads(path.read_text(encoding="utf-8")))
        pairs = {n: tuple(value) for n, value in found.settings.items() if isinstance(value, list)}
        return replace(
            found,
            photos=int(found.photos),
            time=float(found.time),
            settings={**found.settings, **pairs},  # JSON has lists for them
            made=dict(found.made),
            seconds={str(name): float(value) for name, value in found.seconds.items()},
        )
    except (ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: is damaged; start again with --overwrite") from error
