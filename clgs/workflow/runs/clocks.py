"""How long training and poses take on this device, measured before they begin.

Training is timed on a synthetic scene, or on the data set of the run; poses by the first features
and pairs of the photos themselves.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import LEAST_POINTS, Dataset, load_dataset
from clgs.data.images import Pixels
from clgs.data.view import StoredPhoto, View
from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.ops.match import MAX_DESCRIPTORS, upload
from clgs.poses.stages.features import Found, find_features, opencv
from clgs.poses.stages.matching import (
    FIRST_FEATURES,
    MAX_RATIO,
    alike,
    most_telling,
    mutual_matches,
)
from clgs.poses.workspace import THREADS
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform
from clgs.train.config import preset
from clgs.train.run.load import load_for
from clgs.train.run.trainer import Trainer
from clgs.train.step.schedule import REDUCED_BY
from clgs.workflow.events import Event, Note, OnEvent, StageProgress
from clgs.workflow.runs.plan import (
    PRODUCT_SECONDS,
    Photos,
    PosesTime,
    StepSpeed,
    TriedPhotos,
    fit_speed,
    used_cores,
)

SYNTHETIC_ANCHORS, EDGES = 12_500, (160, 960)
"""Anchors of the synthetic scene, and pixels of the edges of its two photos."""

REPEATS, WARM_UP = 12, 3
"""Steps that are timed, and steps before them."""

SHALLOWER = 4.0
"""A pixel of a scene that grew from few anchors takes this many times less than a synthetic one.

Fewer Gaussians lie one behind the other.
"""

GROWN = 3_000
"""If there are fewer anchors at the start, they become many more.

The first steps say little of later ones then, which may take as long as those of the synthetic
scene.
"""

WIDTH = 480
"""Pixels of a data set's photos for the timed steps; half of them for the coarse ones."""

VIEWS = 5
"""Photos of a data set that these steps are on: once all were read, reading takes no time."""

EPOCHS = 2
"""Times that each of these photos is seen to warm up, and again to be timed."""


def synthetic_speed(device: Device) -> StepSpeed:
    """The speed of steps on a synthetic scene, which is like that on a usual photo."""

    def measure(edge: int) -> tuple[int, float]:
        config = preset("quick").for_dataset("photos")
        config = replace(config, start_fill=1.0, start_pixels=0.0)  # all points, and no others
        trainer = Trainer(device, synthetic_dataset(edge), config)
        return edge**2, _step_seconds(trainer, WARM_UP, REPEATS)

    return fit_speed(*map(measure, EDGES))


def speed_on(
    device: Device, data: Path, photos: Photos, run: Path, seed: int, on_event: OnEvent
) -> StepSpeed:
    """The speed of the first steps on the data set ``data`` of these photos.

    Points that are found for it are kept in ``run``, the folder of the run.

    Raises:
        ClgsError: it cannot be trained on.
    """
    width = min(WIDTH, photos.width)
    config = replace(preset("quick"), max_size=width, seed=seed)
    dataset = load_dataset(
        data, downscale=config.downscale, max_size=config.max_size, load_images=False
    )
    if len(dataset.points) < LEAST_POINTS:
        dataset = load_for(config, data, run, lambda line: on_event(Note(line)))
    views = dataset.train[:: max(1, len(dataset.train) // VIEWS)][:VIEWS]
    for view in views:
        view.photo.keep()
    dataset = replace(dataset, train=views)
    config = config.for_dataset(dataset.kind)
    trainer = Trainer(device, dataset, config)
    start, steps = trainer.parameters.count, EPOCHS * len(views)
    coarse = Trainer(device, dataset, replace(config, coarse_to_fine=True))
    pixels = photos.at(width)
    found = fit_speed(
        (pixels // REDUCED_BY**2, _step_seconds(coarse, steps + WARM_UP, steps)),
        (pixels, _step_seconds(trainer, steps + WARM_UP, steps)),
    )
    if start >= GROWN:
        return found
    later = synthetic_speed(device)
    pixel = _between(found.pixel, later.pixel / SHALLOWER)
    return StepSpeed(_between(found.fixed, later.fixed), pixel)


def _between(first: float, later: float) -> float:
    """The geometric mean of the seconds of first and of later steps, but at least ``first``."""
    return max(first, math.sqrt(first * later))


def _step_seconds(trainer: Trainer, warm_up: int, repeats: int) -> float:
    """Median seconds of ``repeats`` steps after ``warm_up`` others."""
    times = [time.perf_counter() for _ in trainer.steps(warm_up + repeats)]
    return median(np.diff(times[warm_up - 1 :]))


def synthetic_dataset(edge: int) -> Dataset:
    """A random photo of ``edge`` x ``edge`` pixels, and random points that fill its view."""
    rng = np.random.default_rng(0)
    place = np.array([0.0, 0.0, 4.0])
    camera = Camera(np.eye(3), place, edge, edge, edge / 2, edge / 2, edge, edge)
    points = rng.uniform(-1, 1, (SYNTHETIC_ANCHORS, 3)) * (1.7, 1.7, 0.5)
    return photo_dataset(camera, points.astype(np.float32))


def photo_dataset(camera: Camera, points: npt.NDArray[np.float32], seed: int = 0) -> Dataset:
    """A data set of one smooth random photo seen by ``camera``; ``points`` (P, 3) to start from."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (camera.height // 8 + 1, camera.width // 8 + 1, 3), np.uint8)
    image = coarse.repeat(8, axis=0).repeat(8, axis=1)[: camera.height, : camera.width]
    photo = StoredPhoto.of(Pixels(np.ascontiguousarray(image), None))
    return Dataset(
        train=[View("synthetic", camera, photo)],
        test=[],
        points=points,
        point_colors=None,
        transform=SceneTransform(),
        radius=1.0,
        kind="transforms",
        skipped=0,
    )


def try_photos(device: Device, files: Sequence[Path], size: int) -> TriedPhotos | None:
    """Find and match the features of photos as ``clgs prepare`` does; None if none can be read.

    ``size``: longer side of the largest photo, pixels.

    Raises:
        DataError: OpenCV cannot be loaded.
    """
    cv2, began = opencv("features"), time.perf_counter()

    def search(photo: Path) -> Found | None:
        try:
            return find_features(cv2, photo, None, size, MAX_DESCRIPTORS)
        except DataError:  # it is named when all are read
            return None

    pool = ThreadPoolExecutor(THREADS)
    try:
        found = [one for one in pool.map(search, files) if one is not None]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # an interruption need not wait
    if not found:
        return None
    seconds = (time.perf_counter() - began) * min(THREADS, len(files)) / len(found)
    largest = [descriptors[:FIRST_FEATURES] for _, descriptors in found]
    uploaded, pairs = upload(device, largest), list(combinations(range(len(found)), 2))
    looked = alike(device, [most_telling(*one) for one in found], pairs)  # builds the kernel, too
    began = time.perf_counter()
    mutual_matches(device, uploaded, largest, pairs, MAX_RATIO)
    taken = (time.perf_counter() - began) * used_cores(THREADS)
    products = sum(len(largest[a]) * len(largest[b]) for a, b in pairs)
    features = float(np.mean([len(descriptors) for _, descriptors in found]))
    product = taken / products if products else PRODUCT_SECONDS
    return TriedPhotos(features, seconds, product, len(looked) / max(1, len(pairs)))


OFF = 0.3
"""A plan is made again if the poses take this share more or less than was said."""

ENOUGH = {"features": 0.04, "matches": 0.2}
"""Shares of these stages after which their time is known."""


class PosesClock:
    """Follows the stages of ``prepare``, and compares their time with what was said."""

    def __init__(
        self,
        said: PosesTime,
        on_news: Callable[[float, float], None],
        on_event: OnEvent,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Receive events, which are passed to ``on_event``.

        Args:
            said: what was planned.
            on_news: is called at once if that is wrong by more than OFF, with the seconds of all
                stages that were said and those that they are going to take.
            on_event: receives all events.
            clock: in seconds.
        """
        self._planned = {"features": said.features, "matches": said.matches}
        self._other, self._said = said.other, said.seconds
        self._on_news, self._on_event, self._clock = on_news, on_event, clock
        self._began = dict[str, tuple[int, float]]()
        self._found = dict[str, float]()

    def __call__(self, event: Event) -> None:
        """Pass an event on; one of a stage may tell how long it takes."""
        self._on_event(event)
        if not isinstance(event, StageProgress):
            return
        stage, now = event.stage, self._clock()
        first, began = self._began.setdefault(stage, (event.done, now))
        if stage not in ENOUGH or stage in self._found:
            return
        if event.done == first:
            if first == event.total:  # an earlier call did it
                self._said -= self._planned.pop(stage, 0.0)
            return
        total, before = event.total, 0.0
        if stage == "matches":  # the first pairs are those that showed nothing at a cheap look
            total, before = total - first, began - self._began.get("looks", (0, began))[1]
        if event.done - first < ENOUGH[stage] * total:
            return
        self._found[stage] = before + (now - began) * total / (event.done - first)
        # What is not known yet is taken to differ from the plan as what is known.
        planned = sum(self._planned.get(each, 0.0) for each in self._found)
        known, whole = sum(self._found.values()), sum(self._planned.values()) + self._other
        taken = known / max(planned, 1e-9) * (whole - planned) + known
        if abs(taken - self._said) > OFF * self._said:
            said, self._said = self._said, taken
            self._on_news(said, taken)
