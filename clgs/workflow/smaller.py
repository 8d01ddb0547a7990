"""A smaller scene without training: a part of it (`clgs crop`), or fewer bytes (`clgs encode`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.smaller import contribution, take
from clgs.data.masks import USED
from clgs.data.reduction import OBJECT
from clgs.errors import DataError, UsageError
from clgs.opencl.device import Device
from clgs.render.frame import upload_scene
from clgs.render.renderer import Renderer
from clgs.scene.camera import photo_range
from clgs.scene.region import Box, Sphere
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.importance import visibility
from clgs.train.quality.rate_control import (
    MAX_VIEWS,
    MEASURED,
    Reduced,
    SceneJudge,
    reduce_to_psnr,
    reduce_to_size,
    spread,
)
from clgs.train.quality.scores import mean_psnr
from clgs.workflow.events import OnEvent, counter, ignore
from clgs.workflow.options import ViewOptions
from clgs.workflow.views import data_of, drawing_options, load_views, select_views, trained_config

INSIDE = 0.5
"""Share of an anchor's weight in masked pictures that must lie where the masks show the object."""


@dataclass(frozen=True)
class CroppedScene:
    """The part that was kept, its file, and PSNR (dB) before and after on ``views`` photos.

    psnr is None, and views 0, if no data set is known.
    """

    scene: QuantizedScene
    data: bytes
    psnr: tuple[float, float] | None
    views: int


def crop(
    path: Path,
    scene: QuantizedScene,
    encode: Callable[[QuantizedScene], bytes],
    views: ViewOptions,
    *,
    regions: Sequence[Box | Sphere] = (),
    masked: bool = False,
    least_views: int = 0,
    on_event: OnEvent = ignore,
) -> CroppedScene:
    """Keep the anchors that meet all conditions, with all their integers; the MLPs stay.

    Args:
        path: where ``scene`` was read.
        scene: what is cropped.
        encode: gives the bytes of a scene.
        views: names the data set, if there is one, and how its photos are read.
        regions: an anchor must lie in each.
        masked: at least INSIDE of an anchor's weight in the training photos that have a mask, or
            alpha, must lie where these show the object. PSNR is over the background there.
        least_views: the least number of training photos that must show an anchor.
        on_event: called as pictures are drawn.

    Raises:
        UsageError: nothing would be left, or photos are needed and not known.
        DataError: the data set is damaged, that of another scene, or has no masks.
    """
    if views.data is None and (masked or least_views):
        views = replace(views, data=data_of(path))
    kept = np.ones(len(scene.anchors), bool)
    for region in regions:
        kept &= region.holds(scene.world_position())
    if views.data is None:
        cropped = _left(path, scene, kept)
        return CroppedScene(cropped, encode(cropped), None, 0)
    dataset = load_views(path, scene, views, on_event)
    if masked and any(view.mask for view in dataset.train):
        dataset = load_views(path, scene, replace(views, masks=OBJECT), on_event)
    device, options = Device(views.device), drawing_options(path, views, scene)
    if masked or least_views:
        # Alpha shows where the object is.
        alphas = (view.photo.pixels().alpha if masked else None for view in dataset.train)
        masks = [None if alpha is None else (alpha >= USED).astype(np.uint8) for alpha in alphas]
        if masked and not any(mask is not None for mask in masks):
            raise DataError(f"{views.data}: no training photo has a mask; leave out --object")
        seen = visibility(
            device,
            upload_scene(device, scene.dequantize()),
            scene.settings,
            [view.camera for view in dataset.train],
            masks,
            options,
            counter("looking at views", len(dataset.train), on_event),
        )
        kept &= seen.views >= least_views
        if masked:
            kept &= (seen.inside >= INSIDE * seen.weight) & (seen.weight > 0)
    cropped = _left(path, scene, kept)
    scored = dataset.test or dataset.train
    advance = counter("measuring PSNR", 2 * len(scored), on_event)
    before, after = (
        mean_psnr(
            Renderer(device, one.dequantize(), options), scored, one.settings.background, advance
        )
        for one in (scene, cropped)
    )
    return CroppedScene(cropped, encode(cropped), (before, after), len(scored))


def _left(path: Path, scene: QuantizedScene, kept: npt.NDArray[np.bool_]) -> QuantizedScene:
    """The anchors where ``kept`` (A,) is true; UsageError if there are none."""
    if not kept.any():
        raise UsageError(f"{path}: nothing would be left; `clgs info` shows the extent of a file")
    return take(scene, np.flatnonzero(kept))


@dataclass(frozen=True)
class EncodedFile:
    """A .clgs file that was written: its bytes and anchors."""

    path: Path
    size: int
    anchors: int


@dataclass(frozen=True)
class FittedScene:
    """What was found, the views that PSNR was measured on, and the number of training views.

    Both counts are 0 if no data set is known.
    """

    found: Reduced
    measured: int = 0
    views: int = 0


def encode_within(
    path: Path,
    scene: QuantizedScene,
    encode: Callable[[QuantizedScene], bytes],
    views: ViewOptions,
    target_size: int | None = None,
    target_psnr: float | None = None,
    all_views: bool = False,
    on_event: OnEvent = ignore,
) -> FittedScene:
    """Leave out anchors, and make Q coarser, until the file meets one of the two targets.

    The training views of the data set that ``views`` names say what is useful; without one, what
    shows from all around is. PSNR (dB) needs them; it is measured on MEASURED of them, or with
    ``all_views`` on all. ``encode`` gives the bytes of a scene, ``path`` says where it was read.

    Raises:
        UsageError: the target cannot be reached.
        DataError: the data set is damaged, or that of another scene.
    """
    if views.data is None:
        assert target_size is not None
        counter("encoding", 0, on_event)
        return FittedScene(reduce_to_size(scene, target_size, encode, None))
    every = select_views(path, scene, replace(views, split="train"), on_event)
    chosen = spread(every, len(every) if all_views else MEASURED)
    for view in chosen:
        view.photo.keep()  # they are read once, the others never
    judge = SceneJudge(
        Device(views.device),
        spread(every, MAX_VIEWS),
        chosen,
        drawing_options(path, views, scene),
        counter("looking at views", 0, on_event),
    )
    if target_psnr is not None:
        found = reduce_to_psnr(scene, target_psnr, encode, judge)
    else:
        assert target_size is not None
        found = reduce_to_size(scene, target_size, encode, judge)
    return FittedScene(found, len(chosen), len(every))


def with_photos(
    path: Path, scene: QuantizedScene, views: ViewOptions, on_event: OnEvent = ignore
) -> QuantizedScene:
    """The scene with the photos that ``views`` names in its settings.

    Raises:
        UsageError: neither ``views`` nor a run folder says at which size it was trained.
        DataError: the data set is damaged, or that of another scene.
    """
    if views.downscale is None and views.max_size is None and trained_config(path) is None:
        size = "give --downscale N or --max-size N as it was trained with"
        raise UsageError(f"{path}: at which size of the photos it was trained is not known; {size}")
    every = select_views(path, scene, replace(views, split="train"), on_event)
    photos = photo_range([view.camera for view in every])
    return replace(scene, settings=replace(scene.settings, photos=photos))


def importance_in_views(
    path: Path, scene: QuantizedScene, views: ViewOptions, on_event: OnEvent = ignore
) -> npt.NDArray[np.float64]:
    """What each anchor (A,) contributes to training views of the data set that ``views`` names.

    Raises:
        DataError: the data set is damaged, or that of another scene.
    """
    every = select_views(path, scene, replace(views, split="train"), on_event)
    return contribution(scene, [view.camera for view in spread(every, MAX_VIEWS)])
