"""The settings of a run as a whole, its learning rates, renders and photos; part of TrainConfig."""

from __future__ import annotations

from dataclasses import dataclass, replace

from clgs.constants import NEAR_PLANE
from clgs.data.reduction import EVERY, IGNORE, LEAST_SIZE, MAX_SIZE, MEANINGS, VIEWS
from clgs.errors import UsageError
from clgs.options import PRESETS
from clgs.train.config.option import (
    POSITIVE,
    WEIGHT,
    Pair,
    Range,
    Text,
    at_least,
    option,
    options_of,
    rates,
)

SHORT_RUN_POWERS = {"feature": (0.5, 0.5), "offset": (0.25, 0.25), "exposure": (0.5, 0.5)}
"""A run n times shorter multiplies the first and the last of these learning rates by n to these
powers.
"""


@dataclass(frozen=True)
class LearningRates:
    """(first, last) of each group, log-linear in between; equal ends stay constant.

    Positions of anchors are not trained, so there is no group for them.
    """

    offset: Pair = rates(
        0.01, 0.0001, "offsets, multiplied by the scene radius", group="learning rates"
    )
    feature: Pair = rates(0.0075, 0.00075, "features (code: constant, which preset paper takes)")
    scaling: Pair = rates(0.007, 0.0007, "scalings (code: 0.007, which preset paper takes)")
    mlp_opacity: Pair = rates(0.002, 2e-5, "the opacity MLP")
    mlp_covariance: Pair = rates(0.004, 0.004, "the covariance MLP")
    mlp_color: Pair = rates(0.008, 5e-5, "the color MLP")
    exposure: Pair = rates(0.01, 0.001, "the exposure of photos (3DGS)")

    def __post_init__(self) -> None:
        for name, one in options_of(LearningRates).items():
            try:
                object.__setattr__(self, name, one.check(getattr(self, name)))
            except UsageError as error:
                raise UsageError(f"learning_rates.{error}") from None

    def for_shorter_run(self, shorter: float) -> LearningRates:
        """The rates of a run that is ``shorter`` times as short, as SHORT_RUN_POWERS says.

        Features and offsets start at zero, and a short run would leave them small compared
        with the steps of rounding when that begins. The exposure of a photo moves only when that
        photo is seen.
        """
        changed = {
            name: tuple(
                rate * shorter**power
                for rate, power in zip(getattr(self, name), powers, strict=True)
            )
            for name, powers in SHORT_RUN_POWERS.items()
        }
        return replace(self, **changed)


FULL_STEPS = 30_000
"""Steps of a whole run (paper)."""

MAX_PIXELS = 65536
"""No picture is wider."""

MAX_SAMPLES = 20_000_000
"""No device of today has memory for more anchors."""

MOST_VIEWS = 1024
"""No step looks at more: it would hardly learn faster."""

LEAST_ANCHORS = 4
"""Fewer have no three neighbours, whose distance sets the first scale."""

TRAINED, OBJECTS, RANDOM = "trained", "objects", "random"
"""Values of start_mlps."""


@dataclass(frozen=True)
class RunSettings:
    """Length, start, log and renders; :class:`TrainConfig` has them first."""

    preset: str = option(
        "default",
        "where the other values start from; quick: 3,000 steps; paper: published constants and "
        "the data's own units",
        ("default", "quick", "paper"),
        group="run",
    )
    steps: int = option(
        FULL_STEPS,
        "training steps, one view each (paper) unless there is a batch; another number than the "
        "preset's also moves, in proportion, the settings that say so",
        at_least(1),
        unit="steps",
    )
    batch: int = option(
        1,
        "views that a step looks at; their mean gradient moves the scene, at learning rates times "
        "the root of the batch (gsplat, Grendel-GS). Growth keeps its pace by views; steps stay as "
        "many as --steps says: for about the same training, divide them by the batch",
        Range(1, MOST_VIEWS),
        unit="views",
        open_default="1, or one for each of --devices",
        later=True,
    )
    seed: int = option(
        0,
        "of all random choices: MLP weights, order of views, growth, random backgrounds, start",
        at_least(0),
        unit="none",
    )
    normalize: bool = option(
        True, "recentre the scene and scale it to a camera radius of 4.4; the paper keeps the units"
    )
    coarse_to_fine: bool = option(
        False, "train on photos of half the size for the first 0.35 of the steps"
    )
    points: str = option(
        "",
        "start from the points of this file instead of the data set's: PLY, OBJ, GLB, STL, OFF or "
        "XYZ, in the data set's world units; surfaces are sampled, colors ignored, GLB turned from "
        "y up as `clgs export` does",
        Text("the name of a file"),
        in_digest=False,  # the points themselves are in it
    )
    point_samples: int = option(
        100_000,
        "points drawn from the surfaces in the file of points",
        Range(4, MAX_SAMPLES),
        unit="points",
        in_digest=False,
    )
    start_points: int = option(
        0,
        "random points to start from if the data set has none (code: 100,000)",
        Range(LEAST_ANCHORS, MAX_SAMPLES, or_zero=True),
        unit="points",
        open_default="30,000 in Blender scenes, fewer in runs of more than 3,000 steps, 10,000 "
        "from 30,000 steps on; 100,000 among photos",
    )
    start_volume: str = option(
        "hull",
        "where random points of Blender scenes lie; hull: no photo shows background there; cube: "
        "anywhere (code)",
        ("hull", "cube"),
    )
    start_pixels: float = option(
        1.5,
        "the data set's points are thinned to at most one for this many pixels of a photo; 0: all "
        "of them stay (code)",
        at_least(0),
        unit="pixels",
    )
    start_fill: float = option(
        3.0,
        "points between near ones are added to those that photos start from, up to this many times "
        "as many in all and one for 6 pixels of a photo; 1: none, as in preset paper",
        at_least(1),
        unit="times",
        later=True,
        before=1.0,
    )
    start_mlps: str = option(
        "",
        "the MLPs to start from; trained: on another scene, shipped; objects: those with 40 of "
        "50 features, smaller files of single objects; random: as PyTorch (code); or those of a "
        "scene: its run folder, .clgs or .npz file",
        Text("trained, objects, random or the name of a scene"),
        open_default="objects in Blender scenes, trained among photos",
    )
    box: str = option(
        "",
        "learn, grow and prune only the anchors in this box, x0,y0,z0,x1,y1,z1; the MLPs rest, the "
        "other anchors are drawn as they are, and no integer is priced or capped; else all learn",
        Text("six numbers with commas between them", "X0,Y0,Z0,X1,Y1,Z1"),
        unit="scene units",
        later=True,
    )
    fixed_views: int = option(
        4, "training views on which PSNR is logged", at_least(0), unit="views"
    )
    log_interval: int = option(
        100,
        "steps between rows of progress.csv, each with the PSNR of the fixed views",
        at_least(1),
        unit="steps",
        in_digest=False,
    )
    checkpoint_interval: int = option(
        1000,
        "steps between checkpoints; 0: only when the run is interrupted",
        at_least(0),
        unit="steps",
        in_digest=False,
    )
    background: str = option(
        "black",
        "color behind transparent photos and unfinished pixels (code: black); random: a new one "
        "every step",
        ("black", "white", "random"),
        group="rendering",
    )
    accuracy: str = option(
        "parity",
        "exact: nearly nothing is truncated; parity: as in 3DGS; fast: below a third of a level "
        "from it; preview: half the resolution, enlarged",
        tuple(PRESETS),
    )
    smallest_anchor: float = option(
        0.0,
        "leave out anchors that are fewer pixels wide on the screen: faster, another picture; "
        "0: none",
        Range(0, MAX_PIXELS),
        unit="pixels",
    )
    near: float = option(
        NEAR_PLANE,
        "distance of the near plane from the camera (code)",
        POSITIVE,
        unit="scene units",
    )
    max_memory: int = option(
        0,
        "draw in groups of tiles whose lists and gradients take at most this much; slower, the "
        "same result; 0: no limit",
        at_least(0),
        unit="MiB",
        in_digest=False,
    )


@dataclass(frozen=True)
class PhotoSettings:
    """Size, memory and exposure of photos; part of :class:`TrainConfig`."""

    downscale: int = option(
        0,
        "reduce the photos this many times, regardless of --max-size; 0: as that says",
        at_least(0),
        unit="times",
        group="photos",
    )
    max_size: int = option(
        MAX_SIZE,
        "reduce photos that are wider to this width (3DGS); 0: never",
        Range(LEAST_SIZE, or_zero=True),
        unit="pixels",
    )
    photo_memory: int = option(
        1024,
        "training photos that stay in memory, 3 bytes a pixel; those beyond it are read again from "
        "the disk, ahead of their steps",
        at_least(0),
        unit="MiB",
        in_digest=False,
    )
    masks: str = option(
        IGNORE,
        "what is where photos are masked; ignore: anything, so that nothing is compared; object: "
        "nothing, so that renders show the background, which is random while training",
        MEANINGS,
        later=True,
    )
    test_every: int = option(
        EVERY,
        "hold out every photo of this number, by name, unless the data set says which; 0: none, "
        "not even those",
        at_least(0),
        unit="photos",
        later=True,
    )
    fisheye_view: float = option(
        0.0,
        "degrees that undistorted photos of fisheye lenses show at most, across and down; 0: all "
        "that fits into twice the width and the height",
        Range(*VIEWS, or_zero=True),
        unit="degrees",
        later=True,
    )
    exposure: bool = option(
        False,
        "learn the exposure of each training photo, an affine map of colors, from a fifth of the "
        "steps on; the scene and the held-out views are without",
    )
    exposure_weight: float = option(
        0.1,
        "weight of the squared distance of a photo's map from none, with --exposure",
        WEIGHT,
        unit="none",
    )
