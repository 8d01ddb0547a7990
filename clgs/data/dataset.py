"""A folder on disk to a data set in scene units: views, and the points that come with it."""

from __future__ import annotations

import logging
import os
import shlex
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.arguments import as_path, check_integer
from clgs.data.complaints import check_masks, check_photos, find_astray
from clgs.data.images import Pixels, box_resized, check_chunks, check_image, list_images, read_image
from clgs.data.lens import sources, undistort_lens, undistort_pixels
from clgs.data.masks import StoredMask, list_masks, read_mask
from clgs.data.points import BLENDER_DISTANCE, BLENDER_TOLERANCE, read_points
from clgs.data.posed_photo import Photo, PhotoSet, hold_out
from clgs.data.programs import find_reader
from clgs.data.reduction import DEFAULT, EVERY, IGNORE, MAX_SIZE, OBJECT, VIEWS, Reduction
from clgs.data.view import (
    DEFAULT_MEMORY,
    PhotoMemory,
    StoredPhoto,
    View,
    is_worth_keeping,
    kept_pixels,
)
from clgs.errors import DataError
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform

Floats = npt.NDArray[np.float64]

SCENE_RADIUS = 4.4
"""Camera radius that structure-from-motion scenes are scaled to; that of Synthetic-NeRF."""

RADIUS_MARGIN = 1.1
"""The radius is this times the largest distance of a camera from the mean camera centre."""

LEAST_POINTS = 4
"""Training cannot start from fewer."""

POINT_SAMPLES = 100_000
"""Points that are drawn on the surfaces of a file of points."""

FAR_LIMIT = 50.0
"""Points further than this many radii (or median distances, if those are larger) are dropped."""

MAX_COORDINATE = 2.0**20 / 200.0
"""Largest |coordinate| in scene units: the codec stores 21 bits of 1/200 unit."""

_log = logging.getLogger(__name__)


@dataclass
class Dataset:
    """Views and initial points in scene units.

    points (P, 3) float32, empty if the data set has none; point_colors (P, 3) uint8 or None;
    radius: 1.1 times the largest distance of a training camera from their mean; transform: world
    to scene; kind: "blender", "transforms", "colmap", or the program that made it; skipped: photos
    named by the data set but missing; reduction: what the views were reduced by; points_file: the
    file that the points were asked to come from, else empty; folder: where it was read, None if it
    was made in memory; photos: the training photos as they are on the disk, in world units; drawn:
    whether the points are random ones, in the order in which they were drawn.
    """

    train: list[View]
    test: list[View]
    points: npt.NDArray[np.float32]
    point_colors: npt.NDArray[np.uint8] | None
    transform: SceneTransform
    radius: float
    kind: str
    skipped: int
    reduction: Reduction = DEFAULT
    points_file: str = ""
    folder: Path | None = None
    photos: list[Photo] = field(default_factory=list)
    drawn: bool = False

    def __repr__(self) -> str:
        """One line: the fields would be pages."""
        views = f"{len(self.train)} training and {len(self.test)} test views"
        return f"<Dataset {self.kind}: {views}, {len(self.points):,} points>"


def is_posed(folder: Path) -> bool:
    """Whether ``folder`` is a data set with poses."""
    return find_reader(folder) is not None


def read_photo_set(root: Path, test_every: int = EVERY) -> PhotoSet:
    """The photos with poses in ``root``; no picture is decoded. ``test_every``: see load_dataset.

    Raises:
        DataError: no data set, or a damaged one.
    """
    read = find_reader(root)
    if read is None:
        raise DataError(f"{root}: {_why_none(root)}")
    found = read()
    if test_every == 0 or (test_every != EVERY and not found.split):
        found.train, found.test = hold_out(found.train + found.test, test_every)
    everyone = found.train + found.test
    used = {photo.mask for photo in everyone} | {photo.path for photo in everyone}
    folders = sorted({photo.path.parent for photo in everyone})
    masks = dict.fromkeys(mask for folder in folders for mask in list_masks(root, folder))
    found.stray_masks = [mask.relative_to(root).as_posix() for mask in masks if mask not in used]
    return found


def _why_none(root: Path) -> str:
    """What ``root``, which is no data set, is instead, and what to do."""
    if root.is_file():
        return "is a file; name the folder of the data set"
    if not root.is_dir():
        return "no such folder; check the path"
    if (root / "config.toml").is_file():
        return "is a run, no data set; name the photos that it was trained on"
    above = next(filter(is_posed, list(root.absolute().parents)[:2]), None)
    if above is not None:
        return f"is a part of a data set; name the whole of it: {above}"
    if any(list_images(folder) for folder in (root, root / "images") if folder.is_dir()):
        return f"photos without poses; run: clgs prepare {shlex.quote(str(root))} -o DATA"
    known = "no transforms.json, transforms_train.json, COLMAP model, cameras of another program"
    return f"{known} or photos; check the path"


def load_dataset(
    path: Path | str,
    *,
    downscale: int = 0,
    max_size: int = MAX_SIZE,
    preset_units: bool = False,
    load_images: bool = True,
    photo_memory: int = DEFAULT_MEMORY,
    points_file: Path | None = None,
    point_samples: int = POINT_SAMPLES,
    seed: int = 0,
    masks: str = IGNORE,
    test_every: int = EVERY,
    fisheye_view: float = 0.0,
) -> Dataset:
    """The data set in the folder ``path``: the cameras of any program that the guide lists.

    A data set without points has none here; ``clgs.train_scene`` finds some before it trains.

    Args:
        path: the folder.
        downscale: both sides of the images are made this many times smaller, by box means, after
            undistortion; 0: see ``max_size``.
        max_size: images that are wider are reduced to this width, pixels, if ``downscale`` is 0;
            0: all keep their size.
        preset_units: keep the given units instead of scaling to SCENE_RADIUS; Blender scenes keep
            them unless they are very small or large.
        load_images: read the training photos now, and check the others. If it is False, photos are
            read when their pixels are asked for, and so is no file of points that the data set
            names.
        photo_memory: bytes that the training photos may take; those beyond it are read each time.
        points_file: a point cloud or mesh to take the points from instead of the data set.
        point_samples: points that are drawn on surfaces, if a file of points has any.
        seed: of the points on surfaces.
        masks: "ignore": masked pixels are compared with nothing; "object": they are transparent.
        test_every: every photo of this number is held out, by name, unless the data set itself
            says which are; 0: none are, not even those.
        fisheye_view: degrees that undistorted photos of fisheye lenses show at most, across and
            down; 0: all that fits into twice the width and the height.

    Raises:
        DataError: nothing usable there; one line with file, field and remedy.
        TypeError: an argument is of another type.
    """
    root, whole = as_path("path", path), {"max_size": max_size, "photo_memory": photo_memory}
    whole |= {"point_samples": point_samples, "seed": seed, "test_every": test_every}
    for name, value in whole.items():
        if check_integer(name, value) < 0:
            raise DataError(f"{name} is {value}; give at least 0")
    points_file = None if points_file is None else as_path("points_file", points_file)
    reduction = Reduction(downscale, max_size)
    photos = read_photo_set(root, test_every)
    if fisheye_view and not VIEWS[0] <= fisheye_view <= VIEWS[1]:
        allowed = "0 or {:g} to {:g} degrees".format(*VIEWS)
        raise DataError(f"fisheye_view is {fisheye_view}; give {allowed}")
    for listed in (photos.train, photos.test):
        listed[:] = [replace(p, lens=replace(p.lens, view=fisheye_view)) for p in listed]
    check_photos(root, photos, reduction)
    check_masks(root, photos, masks)
    transform, radius = _normalise(photos, preset_units, find_astray(root, photos))
    dataset = Dataset(
        *([], [], np.empty((0, 3), np.float32), None),
        *(transform, radius, photos.kind, len(photos.missing)),
        reduction=reduction,
        points_file=str(points_file or ""),
        folder=root,
        photos=photos.train,
    )
    named = points_file or (photos.points_file if load_images else None)
    if named is not None:
        world = read_points(named, point_samples, photos.kind, seed, photos.frame)
        dataset.points, _ = to_scene_points(dataset, world, None)
        if len(dataset.points) < LEAST_POINTS:
            raise DataError(
                f"{named}: only {len(dataset.points)} of its {len(world):,} points lie near the "
                "cameras; give more points, in the world units of the data set"
            )
    elif photos.points is not None:
        dataset.points, dataset.point_colors = to_scene_points(
            dataset, photos.points, photos.point_colors
        )
    memory = PhotoMemory(photo_memory)
    for listed, views in ((photos.train, dataset.train), (photos.test, dataset.test)):
        views += [_view(photo, transform, reduction, memory, masks) for photo in listed]
    if load_images:
        _read_images(dataset, photos.test)
    return dataset


def keep_near(points: Floats, centre: Floats, radius: float) -> npt.NDArray[np.bool_]:
    """Which of the points (P, 3) in scene units are worth keeping, (P,) bool.

    Dropped: not finite, beyond the range of the codec, further from the mean camera ``centre`` (3,)
    than FAR_LIMIT times the larger of ``radius`` and the median distance.
    """
    usable = np.all(np.abs(points) < MAX_COORDINATE, axis=1)
    if not usable.any():
        return np.asarray(usable)
    distance = np.linalg.norm(np.where(usable[:, None], points - centre, 0.0), axis=1)
    limit = FAR_LIMIT * max(radius, float(np.median(distance[usable])))
    return np.asarray(usable & (distance <= limit))


def to_scene_points(
    dataset: Dataset, world: Floats, color: npt.NDArray[np.uint8] | None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8] | None]:
    """Points (P, 3) in world units and their colors (P, 3) as a data set keeps them.

    The result is in scene units, without points that are not finite or too far from the cameras.
    """
    points = dataset.transform.to_scene(world)
    centres = dataset.transform.to_scene(np.array([photo.centre for photo in dataset.photos]))
    near = keep_near(points, centres.mean(axis=0), dataset.radius)
    if not near.all():
        _log.info("dropped %d of %d points as too far away", (~near).sum(), len(near))
    return points[near].astype(np.float32), None if color is None else color[near]


def _normalise(
    photos: PhotoSet, keep_units: bool, astray: npt.NDArray[np.bool_]
) -> tuple[SceneTransform, float]:
    """Scene units and the camera radius in them, from the training cameras that are not astray."""
    centres = np.array([photo.centre for photo in photos.train])[~astray]
    middle = centres.mean(axis=0)
    radius = RADIUS_MARGIN * float(np.linalg.norm(centres - middle, axis=1).max())
    if not radius > 1e-9 * (1.0 + float(np.abs(centres).max())):
        # Cameras in one place (or a single one) say nothing about the size of the scene.
        radius = SCENE_RADIUS
    if keep_units:
        return SceneTransform(frame=photos.frame, place=photos.place), radius
    if photos.kind == "blender":
        distance = float(np.median(np.linalg.norm(centres, axis=1)))
        usual = 1 / BLENDER_TOLERANCE <= distance / BLENDER_DISTANCE <= BLENDER_TOLERANCE
        scale = 1.0 if usual or not distance > 0 else BLENDER_DISTANCE / distance
        return SceneTransform(scale=scale), scale * radius
    x, y, z = map(float, middle)
    transform = SceneTransform((x, y, z), SCENE_RADIUS / radius, photos.frame, photos.place)
    return transform, SCENE_RADIUS


def _view(
    photo: Photo, transform: SceneTransform, reduction: Reduction, memory: PhotoMemory, masks: str
) -> View:
    """The photo undistorted at full resolution, cropped to valid pixels, then reduced."""
    try:
        lens, _ = undistort_lens(photo.lens)
    except DataError as error:
        raise DataError(f"{photo.path}: {error}; correct k1, k2, p1, p2") from error
    size = reduction.size(lens.width, lens.height)
    lens = lens.resized(*size)
    # With x_world = x_scene / s + c, x_cam = R x_world + t becomes R x_scene + s (R c + t).
    moved = photo.rotation @ np.array(transform.centre) + photo.translation
    camera = Camera(
        photo.rotation,
        transform.scale * moved,
        *(lens.fx, lens.fy, lens.cx, lens.cy),
        *(lens.width, lens.height),
    )
    whole, cut_out = (photo.lens.width, photo.lens.height), masks == OBJECT
    read = partial(_pixels, photo, size, cut_out)
    if is_worth_keeping(whole, size):
        files = [photo.path, *([photo.mask] if cut_out and photo.mask else [])]
        read = partial(kept_pixels, files, (photo.lens, size, len(files)), read)
    stored = StoredPhoto(read, memory, str(photo.path))
    mask = StoredMask(partial(_mask_pixels, photo, size)) if photo.mask else None
    return View(photo.name, camera, stored, mask, masks)


def _pixels(photo: Photo, size: tuple[int, int], cut_out: bool) -> Pixels:
    """The photo at ``size``; with ``cut_out`` what is masked is transparent."""
    whole = photo.lens.width, photo.lens.height
    pixels = read_image(photo.path, whole)
    if cut_out and photo.mask is not None:
        used = read_mask(photo.mask, whole) * np.uint8(255)
        alpha = used if pixels.alpha is None else np.minimum(used, pixels.alpha)
        pixels = Pixels(pixels.color, alpha)
    return box_resized(undistort_pixels(pixels, photo.lens), *size)


def _mask_pixels(photo: Photo, size: tuple[int, int]) -> Pixels:
    """A photo's mask as 0 and 255 in one channel, resampled as the photo is."""
    assert photo.mask is not None
    mask = read_mask(photo.mask, (photo.lens.width, photo.lens.height))
    level = Pixels(mask[..., None] * np.uint8(255), None)
    return box_resized(undistort_pixels(level, photo.lens), *size)


def _read_images(dataset: Dataset, unread: list[Photo]) -> None:
    """Read the photos to train on, and all masks; check that the others can be read."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        read = pool.map(lambda view: view.photo.keep(), dataset.train)
        checked = pool.map(lambda photo: check_image(photo.path), unread)
        read_here = [photo.path for photo in dataset.photos]
        read_here += [photo.mask for photo in dataset.photos + unread if photo.mask]
        whole = pool.map(check_chunks, dict.fromkeys(read_here))
        masked = pool.map(lambda view: view.used(), dataset.train + dataset.test)
        for _ in (*read, *checked, *whole, *masked):
            pass
    sources.cache_clear()
