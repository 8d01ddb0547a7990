"""The photos that belong to a scene on the disk, how it is drawn for them, and its scores."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from clgs.data.dataset import Dataset, load_dataset
from clgs.data.origin import read_origin, repose, same_place
from clgs.data.reduction import MAX_SIZE
from clgs.data.view import View
from clgs.errors import DataError, UsageError
from clgs.opencl.device import Device
from clgs.options import BACKGROUNDS, RenderOptions, render_options
from clgs.scene.scene import QuantizedScene, SplatScene
from clgs.train.config import TrainConfig, from_toml
from clgs.train.quality.scores import (
    Measure,
    ViewScore,
    count_drawn,
    evaluate_views,
    summarize,
)
from clgs.workflow.events import Note, OnEvent, counter, ignore
from clgs.workflow.options import ViewOptions, refuse
from clgs.workflow.scenes import check_there, run_folder

DrawableScene = TypeVar("DrawableScene", QuantizedScene, SplatScene, QuantizedScene | SplatScene)


def known_data(scene: Path) -> Path | None:
    """The data set that the run folder of ``scene`` names; None if there is none."""
    origin = read_origin(run_folder(scene))
    return origin.folder if origin is not None and origin.folder.is_dir() else None


def scene_name(photos: Path) -> str:
    """What to call the scene of these photos: by their folder, or the one above a usual name."""
    path = photos.resolve()
    if path.name.lower() in ("images", "photos", "input", "data") and path.parent.name:
        path = path.parent
    return path.stem if path.is_file() else path.name


def data_of(scene: Path) -> Path:
    """The data set that the run folder of ``scene`` names.

    Raises:
        DataError: there is no ``scene``.
        UsageError: its run folder names none, or that is gone.
    """
    check_there(scene)
    origin = read_origin(run_folder(scene))
    if origin is None:
        raise UsageError("the photos are not known; name their data set with --data")
    check_photos_there(scene)
    return origin.folder


def check_photos_there(scene: Path) -> None:
    """Raise UsageError if the run folder of ``scene`` names a data set that is gone."""
    origin = read_origin(run_folder(scene))
    if origin is not None and not origin.folder.exists():
        raise UsageError(f"the data set {origin.folder} is gone; name it with --data")


def trained_config(scene: Path) -> TrainConfig | None:
    """The settings in the run folder that ``scene`` is or lies in; None if there are none."""
    path = run_folder(scene) / "config.toml"
    return from_toml(path.read_text(encoding="utf-8"), str(path)) if path.is_file() else None


def load_views(
    path: Path, scene: QuantizedScene | SplatScene, options: ViewOptions, on_event: OnEvent = ignore
) -> Dataset:
    """The data set in the scene's units, without points; its photos are not read yet.

    ``path``: where the scene was read. A :class:`Note` tells if something had to be assumed.

    Raises:
        UsageError: no data set is named, neither by the options nor by the run.
        DataError: there is no usable data set, or it is that of another scene.
    """
    data = options.data or data_of(path)
    config = trained_config(path)
    if options.downscale is not None:
        downscale, max_size = options.downscale, MAX_SIZE
    elif options.max_size is not None:
        downscale, max_size = 0, options.max_size
    elif config is not None:
        downscale, max_size = config.downscale, config.max_size
    else:
        on_event(Note(f"no config.toml next to the scene; --max-size {MAX_SIZE} is assumed"))
        downscale, max_size = 0, MAX_SIZE
    trained, test_every = config or TrainConfig(), options.test_every
    dataset = load_dataset(
        data,
        downscale=downscale,
        max_size=max_size,
        load_images=False,
        masks=options.masks or trained.masks,
        test_every=trained.test_every if test_every is None else test_every,
        fisheye_view=trained.fisheye_view,
    )
    posed = repose(dataset, scene.transform)
    splats = isinstance(scene, SplatScene)
    if doubt := "" if splats else same_place(run_folder(path), dataset, posed, data):
        on_event(Note(doubt))
    return posed


def check_photo_options(options: ViewOptions) -> None:
    """Raise UsageError if options say how photos are read, and there are none."""
    if options.data is None:
        given = {name: getattr(options, name) for name in ("downscale", "max_size", "masks")}
        refuse(given, "no photos are known without --data; leave it out")


def select_views(
    path: Path, scene: QuantizedScene | SplatScene, options: ViewOptions, on_event: OnEvent = ignore
) -> list[View]:
    """The views of the split that ``options`` name, as :func:`load_views` loads them.

    Raises:
        UsageError: no data set is named, neither by the options nor by the run.
        DataError: the split is empty, or the data set is that of another scene.
    """
    data = options.data or data_of(path)
    dataset = load_views(path, scene, replace(options, data=data), on_event)
    views = dataset.train if options.split == "train" else dataset.test
    if not views:
        split, other = ("train", "test") if options.split == "train" else ("test", "train")
        raise DataError(f"{data}: has no {split} views; try --split {other}")
    return views


def over_background(scene: DrawableScene, background: str | None) -> DrawableScene:
    """The scene over the named background; over its own if none is named."""
    if background is None:
        return scene
    settings = replace(scene.settings, background=BACKGROUNDS[background])
    return replace(scene, settings=settings)


def drawing_options(
    path: Path, options: ViewOptions, scene: QuantizedScene | SplatScene
) -> RenderOptions:
    """How ``scene``, read at ``path``, is drawn, the memory budget included.

    Raises:
        UsageError: an option is for anchors, and the scene has splats.
    """
    if isinstance(scene, SplatScene) and options.smallest_anchor is not None:
        raise UsageError(f"--smallest-anchor: {path} holds splats, no anchors; leave it out")
    trained = trained_config(path) or TrainConfig()
    smallest = options.smallest_anchor
    return render_options(
        options.accuracy or trained.accuracy,
        options.max_memory,
        trained.smallest_anchor if smallest is None else smallest,
    )


@dataclass(frozen=True)
class Evaluation:
    """The means over the views with what they depend on, and the scores of each view."""

    summary: dict[str, Any]
    scores: list[ViewScore]

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return self.summary | {"per_view": [score.record() for score in self.scores]}


def evaluate(
    device: Device,
    path: Path,
    scene: QuantizedScene | SplatScene,
    size: int | None,
    views: ViewOptions,
    *,
    lpips: Measure | None = None,
    count_gaussians: bool = False,
    on_event: OnEvent = ignore,
) -> Evaluation:
    """Score ``scene``, which was read at ``path``, on the views of its data set.

    ``size``: bytes of its file, None if it has none. LPIPS is measured if it is given, and the
    Gaussians that are drawn are counted if ``count_gaussians`` says so.

    Raises:
        UsageError: no data set is named, neither by ``views`` nor by the run.
        DataError: the data set is damaged, empty, or that of another scene.
        BudgetError: ``views.max_memory`` is too small.
    """
    scene = over_background(scene, views.background)
    options = drawing_options(path, views, scene)
    chosen = select_views(path, scene, views, on_event)
    advance = counter("evaluating", len(chosen), on_event)
    scores = evaluate_views(device, scene, chosen, advance, options, lpips)
    summary = summarize(scene, scores, size)
    if count_gaussians and not isinstance(scene, SplatScene):
        advance = counter("counting Gaussians", len(chosen), on_event)
        cameras = [view.camera for view in chosen]
        summary["gaussians"] = count_drawn(device, scene, cameras, options, advance)
    summary |= {
        "accuracy": options.accuracy.name,
        "split": views.split or "test",
        "device": device.name,
    }
    return Evaluation(summary, scores)
