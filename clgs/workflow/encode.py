"""A smaller file of a trained scene, without training: `clgs encode --target-size`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec.contribution import contribution
from clgs.errors import UsageError
from clgs.opencl.device import Device
from clgs.scene.camera import photo_range
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.rate_control import (
    MAX_VIEWS,
    MEASURED,
    Reduced,
    SceneJudge,
    reduce_to_psnr,
    reduce_to_size,
    spread,
)
from clgs.workflow.events import OnEvent, counter, ignore
from clgs.workflow.options import ViewOptions
from clgs.workflow.views import drawing_options, select_views, trained_config


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
    cameras = [view.camera for view in every]
    chosen = [every[i] for i in spread(cameras, len(cameras) if all_views else MEASURED)]
    for view in chosen:
        view.photo.keep()  # they are read once, the others never
    judge = SceneJudge(
        Device(views.device),
        [every[i] for i in spread(cameras, MAX_VIEWS)],
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
    cameras = [view.camera for view in every]
    return contribution(scene, [cameras[i] for i in spread(cameras, MAX_VIEWS)])
