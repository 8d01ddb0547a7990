"""What `clgs run` intends: resolution and steps that fit the time, by the speed of this device."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from clgs.data.reduction import IGNORE, OBJECT
from clgs.poses.stages.check import fit_together
from clgs.poses.stages.features import FINEST_SIZE, MAX_FEATURES, QUICK_FEATURES
from clgs.poses.stages.mapping import MANY
from clgs.poses.stages.matching import FIRST_FEATURES, MAX_FULL
from clgs.poses.stages.pairs import MAX_EXHAUSTIVE
from clgs.train.step.schedule import REDUCED_BY, REDUCED_SHARE

DEFAULT_SECONDS = 600.0
"""The time for everything, unless the user says otherwise."""

SIZES = (1600, 1280, 960, 800, 640, 480, 400, 320, 240)
"""Widths that photos are reduced to, of which the largest that leaves enough steps is taken."""

SPARE = 2
"""Photos that are given a width are prepared at this many times that, so that no detail is lost."""

ENOUGH_STEPS = 1500
"""Below this, smaller pictures with more steps give the better scene (docs/guide/run.md)."""

SHORT_STEPS, LARGE_PIXELS = 1_900, 100_000
"""Runs of fewer steps on photos of at least this many pixels begin with photos of half the size.

The pictures are as good, in fewer bytes and less time (docs/benchmarks/sizes.md). This does not
hold for synthetic objects.
"""

MOST_STEPS = 30_000
LEAST_STEPS = 300
"""Fewer give nothing that is worth looking at."""

PHOTO_SECONDS, PIXEL_SECONDS, FEATURE_SECONDS = 0.02, 0.11e-6, 52e-6
"""Seconds of one core for the features of a photo, per pixel that is searched, and per feature."""

KEPT = 1.2
"""Finding features and writing them into the database takes this many times the search."""

FEATURES_PER_PIXEL = 2.4e-3
"""Features per pixel that is searched, of photos that were not tried."""

PAIR_SECONDS, PRODUCT_SECONDS, GEOMETRY_SECONDS = 0.004, 3.2e-9, 0.017
"""Seconds of one core per pair of photos, for the cheap look; per product of a feature of one with
a feature of the other, if none was tried; and for the geometry of the pair."""

MAPPING_SECONDS, SOLVING_SECONDS, SOLVING_GROWTH = {True: 0.32, False: 0.54}, 0.06, 400
"""Seconds per photo of FIRST_FEATURES of mappers, which use one core, for one reconstruction or for
two, and of any photo; of the global mapper, which has more than MANY, one per this number of them.
"""

WRITTEN_SECONDS = 0.08e-6
"""Seconds per pixel that is undistorted and written."""

FIXED_SECONDS = 2.5

NEAR_PAIRS = 10
"""This many pairs per photo are matched in any case."""

MOST_PAIRS = 19
"""About this many pairs per photo are matched in sets of more than MAX_EXHAUSTIVE photos."""

LEAST_SHARE = 0.25
"""Training and what follows it get this share of the whole time at least, however long the poses
take."""

POSES_SHARE = 0.45
"""Poses are tested by a second reconstruction if finding them then takes no larger share."""

LATE = 1.05
"""A plan that takes more than this many times the given time is said to be late."""

SKETCH_STEPS, SKETCH_TIMES = 1000, 4
"""A run of fewer steps is called a sketch, and this many times its time is recommended."""

FRAMES = (100, 80, 60, 50, 40, 30)
"""Frames of a video: the most whose poses take no larger share without that test."""

ROUNDS = 1.6
"""The mean step of a run takes this many times the first ones: rounds, growth, reading."""

LATER_STEPS = 610
"""Baking takes as long as this many steps. What else follows, but the clip, takes LATER_SECONDS."""

LATER_SECONDS = 8.0

CLIPS = ((10, 30, 1080), (10, 30, 720), (10, 24, 720), (10, 15, 720), (8, 12, 720), (8, 12, 480))
"""Seconds, frames per second and pixels of the shorter side of a clip, from the best on."""

CLIP_SHARE = 0.12
"""The share of the whole time that the clip may take; the last of CLIPS is made in any case."""

FRAME_STEPS = 0.7
"""A frame of the clip takes this many times a training step on as many pixels, its coding too."""


@dataclass(frozen=True)
class TriedPhotos:
    """What a few photos of a run tell of all.

    features: that a photo has; seconds: of one core, to find them; product: seconds of one core per
    product of a feature of a photo with one of another; alike: share of their pairs that a cheap
    look passes, though the photos are far apart by name.
    """

    features: float
    seconds: float
    product: float
    alike: float = 1.0


@dataclass(frozen=True)
class Photos:
    """The photos of a run: their number, the size of the first, if they are synthetic, masks.

    meaning: what the masks mean, "ignore" or "object"; trial: if some were tried.
    """

    count: int
    width: int
    height: int
    synthetic: bool = False
    masks: int = 0
    meaning: str = IGNORE
    trial: TriedPhotos | None = None

    def masks_in_words(self) -> str:
        """What is made of the masks, and the option that changes it; empty if there are none."""
        if not self.masks:
            return ""
        done, other = "masked pixels are not compared", OBJECT
        if self.meaning == OBJECT:
            done, other = "they cut out the object, and nothing is asked for around it", IGNORE
        masks = f"{self.masks} mask{'s' * (self.masks > 1)}"
        return f"{masks}: {done} (--masks {other} if that is wrong)"

    def mask_settings(self) -> dict[str, str]:
        """The setting of training that the masks ask for, if there are any."""
        return {"masks": self.meaning} if self.masks else {}

    def at(self, width: int) -> int:
        """Pixels of a photo that is at most ``width`` wide."""
        reduced = min(width, self.width)
        return reduced * max(1, round(self.height * reduced / self.width))


@dataclass(frozen=True)
class StepSpeed:
    """Seconds of a training step: fixed, and per pixel of the photo."""

    fixed: float
    pixel: float

    def step(self, pixels: int) -> float:
        """Seconds of a step on a photo of ``pixels``."""
        return self.fixed + self.pixel * pixels


@dataclass(frozen=True)
class Presentation:
    """What the user may choose of what a run shows to others.

    title: of report and page, by default the name of the photos' folder; path: of the clip, "none"
    for no clip; seconds: of the clip; size: width and height of its frames in pixels.
    """

    title: str | None = None
    path: str | None = None
    seconds: float | None = None
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class ClipPlan:
    """A clip along a path, with its frames, frames per second and size, and what it takes.

    path: a name of ``clgs.workflow.options.PATHS``, a .json file, "none" for no clip, or "" for the
    one that suits the cameras.
    """

    path: str
    frames: int
    fps: float
    width: int
    height: int
    seconds: float


def plan_clip(photos: Photos, speed: StepSpeed, allowed: float, chosen: Presentation) -> ClipPlan:
    """The best of CLIPS that takes at most CLIP_SHARE of ``allowed`` seconds, or as ``chosen``.

    No frame is larger than the photos unless that is chosen.
    """

    def plan(length: float, fps: float, side: int) -> ClipPlan:
        times = min(1.0, side / min(photos.width, photos.height))
        sides = (max(2, 2 * round(times * one / 2)) for one in (photos.width, photos.height))
        width, height = chosen.size or tuple(sides)
        frames = 0 if chosen.path == "none" else max(1, round(fps * (chosen.seconds or length)))
        seconds = frames * FRAME_STEPS * speed.step(width * height)
        return ClipPlan(chosen.path or "", frames, fps, width, height, seconds)

    plans = [plan(*one) for one in CLIPS]
    return next((one for one in plans if one.seconds <= CLIP_SHARE * allowed), plans[-1])


@dataclass(frozen=True)
class TrainingPlan:
    """Size and length of a training, and seconds by stage; the others are all that follows it.

    Wider photos are reduced to ``max_size`` pixels; ``coarse``: training begins with half of it;
    ``clip``: is among the others.
    """

    max_size: int
    steps: int
    coarse: bool
    prepare_seconds: float
    train_seconds: float
    other_seconds: float
    clip: ClipPlan

    @property
    def seconds(self) -> float:
        """The time of the whole run."""
        return self.prepare_seconds + self.train_seconds + self.other_seconds


def fit_speed(small: tuple[int, float], large: tuple[int, float]) -> StepSpeed:
    """The line through two steps, each given by the pixels of its picture and its seconds."""
    pixel = max(0.0, large[1] - small[1]) / max(1, large[0] - small[0])
    return StepSpeed(max(1e-4, small[1] - pixel * small[0]), pixel)


@dataclass(frozen=True)
class PosesTime:
    """Seconds that structure from motion takes for features, for matches, and for all else."""

    features: float
    matches: float
    other: float

    @property
    def seconds(self) -> float:
        """The sum."""
        return self.features + self.matches + self.other


def poses_time(photos: Photos, cores: int, quick: bool) -> PosesTime:
    """What structure from motion usually takes for photos of about one size."""
    count, cores = photos.count, used_cores(cores)
    shrink = min(2.0, FINEST_SIZE / max(photos.width, photos.height))
    searched = photos.width * photos.height * shrink**2
    found, product, pace, share = FEATURES_PER_PIXEL * searched, PRODUCT_SECONDS, 1.0, 1.0
    search = PHOTO_SECONDS + PIXEL_SECONDS * searched
    if (trial := photos.trial) is not None:
        found, product, share = trial.features, trial.product, trial.alike
        pace = trial.seconds / (search + FEATURE_SECONDS * found)
    features = count * KEPT * pace * (search + FEATURE_SECONDS * found)
    found = min(found, QUICK_FEATURES if quick else MAX_FEATURES)
    used = found if count <= MAX_FULL else min(found, FIRST_FEATURES)
    pairs = count * (count - 1) / 2 if count <= MAX_EXHAUSTIVE else MOST_PAIRS * count
    near = min(pairs, (NEAR_PAIRS if count <= MAX_EXHAUSTIVE else MOST_PAIRS) * count)
    matched = near + share * (pairs - near)
    once = quick or (cores > 1 and fit_together(count))  # the second one is made meanwhile
    mapping = MAPPING_SECONDS[once] * used / FIRST_FEATURES
    mapping += count / SOLVING_GROWTH if count > MANY else SOLVING_SECONDS
    written = WRITTEN_SECONDS * photos.at(SIZES[0])
    other = matched * GEOMETRY_SECONDS / cores + count * (mapping + written)
    return PosesTime(
        features / cores,
        (pairs * pace * PAIR_SECONDS + matched * product * used**2) / cores,
        FIXED_SECONDS + pace * other,
    )


def used_cores(cores: int) -> int:
    """How many of ``cores`` structure from motion has use for."""
    return max(1, min(cores, 8))


def must_hurry(photos: Photos, cores: int, seconds: float) -> bool:
    """Whether ``seconds`` for everything leave no time for tests of the poses.

    It is by the usual speed, not by that of a trial: other poses would follow from a busy moment.
    """
    usual = replace(photos, trial=None)
    return poses_time(usual, cores, quick=False).seconds > POSES_SHARE * seconds


def frames_within(video: Photos, cores: int, seconds: float) -> int:
    """Frames of a video that leave time for the rest, if ``seconds`` are for everything."""
    for count in FRAMES:
        frames = replace(video, count=count)
        if poses_time(frames, cores, quick=True).seconds <= POSES_SHARE * seconds:
            return count
    return FRAMES[-1]


def make_plan(
    photos: Photos,
    speed: StepSpeed,
    preparing: float,
    seconds: float,
    steps: int | None = None,
    max_size: int | None = None,
    shown: Presentation | None = None,
) -> TrainingPlan:
    """The plan that fits ``seconds`` for the whole, of which the poses take ``preparing``.

    It has the ``steps``, the ``max_size`` and what of the clip are given.
    """
    drawn = plan_clip(photos, speed, seconds, shown or Presentation())
    left = max(0.0, seconds - preparing - drawn.seconds)
    if max_size is None:
        wanted = steps if steps is not None else ENOUGH_STEPS
        paces = ((size, _Pace(photos, speed, min(size, photos.width))) for size in SIZES)
        fitting = (size for size, pace in paces if pace.affordable(left) >= wanted)
        max_size = min(next(fitting, SIZES[-1]), photos.width)
    pace = _Pace(photos, speed, max_size)
    if steps is None:
        steps = min(max(pace.affordable(left), LEAST_STEPS), MOST_STEPS)
    coarse = pace.coarse(steps)
    later = pace.later + drawn.seconds
    return TrainingPlan(max_size, steps, coarse, preparing, pace.training(steps), later, drawn)


class _Pace:
    """What steps on photos at most ``width`` wide take."""

    def __init__(self, photos: Photos, speed: StepSpeed, width: int) -> None:
        pixels = photos.at(width)
        self._large = pixels >= LARGE_PIXELS and not photos.synthetic
        self._step = speed.step(pixels)
        reduced = speed.step(pixels // REDUCED_BY**2)
        self._coarse_step = REDUCED_SHARE * reduced + (1 - REDUCED_SHARE) * self._step
        self.later = LATER_SECONDS + LATER_STEPS * self._step
        """Seconds of all that follows training."""

    def coarse(self, steps: int) -> bool:
        """Whether a run of ``steps`` begins with photos of half the size."""
        return self._large and steps < SHORT_STEPS

    def training(self, steps: int) -> float:
        """Seconds of a run of ``steps``."""
        return ROUNDS * steps * (self._coarse_step if self.coarse(steps) else self._step)

    def affordable(self, seconds: float) -> int:
        """The most steps for which ``seconds`` suffice, what follows them included."""
        left = max(0.0, seconds - self.later)
        steps = math.floor(left / (ROUNDS * self._step))
        if not self.coarse(steps):
            return steps
        return min(math.floor(left / (ROUNDS * self._coarse_step)), SHORT_STEPS - 1)
