"""A folder on disk to a data set that can be trained on: views, initial points, scene units."""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.data.apart import ASTRAY, apart, in_one_place
from clgs.data.images import Pixels, box_resized, check_image, list_images, read_image
from clgs.data.lens import Lens, forget_sources, undistort_lens, undistort_pixels
from clgs.data.masks import StoredMask, read_mask
from clgs.data.point_file import PointFile, read_points
from clgs.data.points import RandomStart, keep_near, random_points, viewpoint
from clgs.data.posed_photo import Photo, PhotoSet
from clgs.data.reduction import DEFAULT, Reduction
from clgs.data.stored_photo import PhotoMemory, StoredPhoto
from clgs.data.view import View
from clgs.errors import DataError
from clgs.scene.camera import Camera
from clgs.scene.scene import SceneTransform

SCENE_RADIUS = 4.4
"""Camera radius that structure-from-motion scenes are scaled to; that of Synthetic-NeRF."""

RADIUS_MARGIN = 1.1
"""The radius is this times the largest distance of a camera from the mean camera centre."""

MIN_POINTS = 100
"""Fewer triangulated points count as a failure."""

LEAST_POINTS = 4
"""Training cannot start from fewer."""

POINT_SAMPLES = 100_000
"""Points on the surfaces of a mesh that a data set names."""

NAMED = 8
"""Of missing photos, at most so many are named."""

_log = logging.getLogger(__name__)


@dataclass
class Dataset:
    """Views and initial points in scene units.

    points (P, 3) float32, may be empty; point_colors (P, 3) uint8 or None; radius: 1.1 times the
    largest distance of a training camera from their mean; transform: world to scene; kind:
    "blender", "transforms" or "colmap"; skipped: photos named by the data set but missing;
    reduction: what the views were reduced by; points_file: the file that the points come
    from, empty if that is the data set; folder: where it was read, None if it was made in memory.
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

    def __repr__(self) -> str:
        """One line: the fields would be pages."""
        views = f"{len(self.train)} training and {len(self.test)} test views"
        return f"<Dataset {self.kind}: {views}, {len(self.points):,} points>"


def load_dataset(
    path: Path | str,
    *,
    downscale: int | Reduction = DEFAULT,
    preset_units: bool = False,
    cache: Path | None = None,
    seed: int = 0,
    load_images: bool | PhotoMemory = True,
    load_points: bool | PointFile | RandomStart = True,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Dataset:
    """The data set in the folder ``path``: Blender, transforms.json or COLMAP.

    Args:
        path: the folder.
        downscale: images are made this many times smaller, by box means, after undistortion; by
            default those wider than 1,600 pixels are reduced to that width.
        preset_units: keep the given units instead of scaling to SCENE_RADIUS.
        cache: folder in which triangulated points are kept; never the data folder.
        seed: of random, sampled and triangulated points.
        load_images: read the training photos now, and check the others; without, photos are read
            when their pixels are asked for, and points come from COLMAP models only; or the memory
            that the training photos may take, beyond which they are read again each time.
        load_points: without, none are triangulated or drawn: enough to render and evaluate; or a
            file to take the points from instead of the data set, or what to draw if it has none.
        on_stage: called with a line before work that takes minutes.

    Raises:
        DataError: nothing usable there; one line with file, field and remedy.
    """
    reduction = _reduction(downscale)
    photos = read_photo_set(Path(path))
    _check_photos(path, photos, reduction)
    transform, radius = _normalise(photos, preset_units, _astray(path, photos))
    source = load_points if isinstance(load_points, PointFile) else None
    wanted = load_images is not False and load_points is not False
    if named := source or _own_points(photos, wanted):
        _take_points(photos, named, seed, transform, radius)
    memory = load_images if isinstance(load_images, PhotoMemory) else PhotoMemory()
    train, test = (
        [_view(photo, transform, reduction, memory) for photo in some]
        for some in (photos.train, photos.test)
    )
    if load_images is not False:
        _load(train, test, photos.test)
    make_points = wanted and not source
    if make_points and photos.points is None and photos.kind != "blender":
        _triangulate(photos, cache, seed, on_stage)
    points, colors = _scene_points(photos, transform, radius)
    if make_points and len(points) < LEAST_POINTS:
        if photos.points is not None:
            _log.warning("%s: only %d usable points, starting from random ones", path, len(points))
        start = load_points if isinstance(load_points, RandomStart) else RandomStart()
        points, colors = _random_points(path, photos.kind, train, radius, start, seed), None
    return Dataset(
        *(train, test, points, colors, transform, radius, photos.kind, len(photos.missing)),
        reduction=reduction,
        points_file=str(source.path) if source else "",
        folder=Path(path),
    )


def _reduction(downscale: int | Reduction) -> Reduction:
    """What ``downscale`` stands for."""
    found = downscale if isinstance(downscale, Reduction) else Reduction(downscale)
    if not isinstance(found.times, int) or found.times < 0 or downscale == 0:
        raise DataError(f"downscale is {downscale}; give a whole number of at least 1")
    return found


def _check_photos(path: Path | str, photos: PhotoSet, reduction: Reduction) -> None:
    """Raise DataError unless there is something to train on that can be reduced so."""
    _name_missing(path, photos)
    if not photos.train:
        raise DataError(f"{path}: no photo is left to train on; hold out fewer")
    _name_standing(path, photos)
    least = min(min(p.lens.width, p.lens.height) for p in photos.train + photos.test)
    if reduction.times > least:
        raise DataError(
            f"downscale is {reduction.times}; the photos are {least} pixels, give at most that"
        )


def _name_missing(path: Path | str, photos: PhotoSet) -> None:
    """Warn of the photos that the data set names but lacks, with the first of their names."""
    missing = photos.missing
    if missing:
        total = len(missing) + len(photos.train) + len(photos.test)
        named = _named(missing)
        _log.warning("%s: %d of %d photos are missing: %s", path, len(missing), total, named)


def _name_standing(path: Path | str, photos: PhotoSet) -> None:
    """Warn of a camera that only turned."""
    centres = np.array([photo.centre for photo in photos.train])
    if len(centres) > 1 and in_one_place(centres):
        _log.warning(
            "%s: all cameras are in one place, so no depth can be told; walk, not turn", path
        )


def _named(names: list[str]) -> str:
    """The first of some names, printable."""
    shown = [name[:80] if name.isprintable() else repr(name[:80]) for name in names[:NAMED]]
    return ", ".join(shown) + ", ..." * (len(names) > NAMED)


def _astray(path: Path | str, photos: PhotoSet) -> npt.NDArray[np.bool_]:
    """Which training cameras (N,) no capture has where they are; warns of those held out, too."""
    everyone = photos.train + photos.test
    astray = apart(np.array([photo.centre for photo in everyone]), ASTRAY)
    if astray.any():
        names = [photo.name for photo, far in zip(everyone, astray, strict=True) if far]
        _log.warning(
            "%s: more than %d times as far from the middle as half of the cameras, so their poses "
            "are wrong: %s; leave these photos out",
            *(path, ASTRAY, _named(names)),
        )
    return astray[: len(photos.train)]


def _own_points(photos: PhotoSet, wanted: bool) -> PointFile | None:
    """The file that the data set names for its points, if they are ``wanted``."""
    file = photos.points_file
    return PointFile(file, POINT_SAMPLES) if wanted and file is not None else None


def _take_points(
    photos: PhotoSet, source: PointFile, seed: int, transform: SceneTransform, radius: float
) -> None:
    """Replace the photo set's points by those of a file."""
    photos.points, photos.point_colors = read_points(source, photos.kind, seed), None
    usable = len(_scene_points(photos, transform, radius)[0])
    if usable < LEAST_POINTS:
        raise DataError(
            f"{source.path}: only {usable} of its points lie near the cameras; give coordinates "
            "in the world units of the data set"
        )


def _random_points(
    path: Path | str,
    kind: str,
    train: list[View],
    radius: float,
    start: RandomStart,
    seed: int,
) -> npt.NDArray[np.float32]:
    """Points (P, 3) in scene units in the volume that the training cameras share."""
    viewpoints = [viewpoint(view.camera, view.photo.pixels().alpha) for view in train]
    points = random_points(viewpoints, radius, kind == "blender", seed, start)
    if len(points) < LEAST_POINTS:
        raise DataError(
            f"{path}: no two photos look at the same place; check the poses and their axes"
        )
    return points


def read_photo_set(root: Path) -> PhotoSet:
    """The photos with poses in ``root`` by the files that are there; no picture is decoded.

    Raises:
        DataError: no data set, or a damaged one.
    """
    from clgs.data.colmap.model import find_model, read_colmap
    from clgs.data.transforms import read_blender, read_transforms

    if root.is_file():
        raise DataError(f"{root}: is a file; name the folder of the data set")
    if not root.is_dir():
        raise DataError(f"{root}: no such folder; check the path")
    if (root / "transforms_train.json").is_file():
        return read_blender(root)
    if (root / "transforms.json").is_file():
        return read_transforms(root)
    model = find_model(root)
    if model is not None:
        return read_colmap(root, model)
    if (root / "config.toml").is_file():
        raise DataError(f"{root}: is a run, no data set; name the photos that it was trained on")
    above = next(filter(_is_posed, list(root.absolute().parents)[:2]), None)
    if above is not None:
        raise DataError(f"{root}: is a part of a data set; name the whole of it: {above}")
    folders = [root, root / "images"]
    if any(list_images(folder) for folder in folders if folder.is_dir()):
        named = shlex.quote(str(root))
        raise DataError(f"{root}: photos without poses; run: clgs prepare {named} -o DATA")
    raise DataError(
        f"{root}: no transforms.json, transforms_train.json, sparse/0 or photos; check the path"
    )


def _is_posed(folder: Path) -> bool:
    """Whether ``folder`` is a data set with poses."""
    from clgs.data.colmap.model import find_model

    names = ("transforms_train.json", "transforms.json")
    return any((folder / name).is_file() for name in names) or find_model(folder) is not None


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
    if keep_units or photos.kind == "blender":
        return SceneTransform(), radius
    x, y, z = map(float, middle)
    return SceneTransform((x, y, z), SCENE_RADIUS / radius), SCENE_RADIUS


def _view(
    photo: Photo, transform: SceneTransform, reduction: Reduction, memory: PhotoMemory
) -> View:
    """The photo undistorted at full resolution, cropped to valid pixels, then reduced."""
    try:
        lens, _ = undistort_lens(photo.lens)
    except DataError as error:
        raise DataError(f"{photo.path}: {error}; correct k1, k2, p1, p2") from error
    size = reduction.size(lens.width, lens.height)
    camera = _camera(photo, lens.resized(*size), transform)
    stored = StoredPhoto(partial(_pixels, photo, size), memory, str(photo.path))
    mask = StoredMask(partial(_mask_pixels, photo, size)) if photo.mask else None
    return View(photo.name, camera, stored, mask)


def _pixels(photo: Photo, size: tuple[int, int]) -> Pixels:
    pixels = read_image(photo.path, (photo.lens.width, photo.lens.height))
    return box_resized(undistort_pixels(pixels, photo.lens)[0], *size)


def _mask_pixels(photo: Photo, size: tuple[int, int]) -> Pixels:
    """A photo's mask as 0 and 255 in one channel, resampled as the photo is."""
    assert photo.mask is not None
    mask = read_mask(photo.mask, (photo.lens.width, photo.lens.height))
    level = Pixels(mask[..., None] * np.uint8(255), None)
    return box_resized(undistort_pixels(level, photo.lens)[0], *size)


def _load(train: list[View], test: list[View], unread: list[Photo]) -> None:
    """Read the photos to train on, and all masks; see that the others can be read."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        read = pool.map(lambda view: view.photo.keep(), train)
        checked = pool.map(lambda photo: check_image(photo.path), unread)
        masked = pool.map(lambda view: view.used(), train + test)
        for _ in (*read, *checked, *masked):
            pass
    forget_sources()


def _camera(photo: Photo, lens: Lens, transform: SceneTransform) -> Camera:
    """With x_world = x_scene / s + c, x_cam = R x_world + t becomes R x_scene + s (R c + t)."""
    moved = photo.rotation @ np.array(transform.centre) + photo.translation
    return Camera(
        photo.rotation,
        transform.scale * moved,
        lens.fx,
        lens.fy,
        lens.cx,
        lens.cy,
        lens.width,
        lens.height,
    )


def _triangulate(
    photos: PhotoSet, cache: Path | None, seed: int, on_stage: Callable[[str], None]
) -> None:
    """Fill in the points from the training photos; on failure they stay None."""
    from clgs.poses.triangulate import triangulate

    try:
        points = triangulate(photos.train, cache, seed, on_stage)
    except DataError as error:
        _log.warning("no triangulated points, starting from random ones: %s", error)
        return
    if len(points.position) < MIN_POINTS:
        _log.warning("only %d points triangulated, starting from random ones", len(points.position))
        return
    photos.points, photos.point_colors = points.position, points.color


def _scene_points(
    photos: PhotoSet, transform: SceneTransform, radius: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8] | None]:
    """The photo set's points in scene units without those too far away."""
    if photos.points is None:
        return np.empty((0, 3), np.float32), None
    points = transform.to_scene(photos.points)
    centres = transform.to_scene(np.array([photo.centre for photo in photos.train]))
    near = keep_near(points, centres.mean(axis=0), radius)
    if not near.all():
        _log.info("dropped %d of %d points as too far away", (~near).sum(), len(near))
    colors = photos.point_colors
    return points[near].astype(np.float32), None if colors is None else colors[near]
