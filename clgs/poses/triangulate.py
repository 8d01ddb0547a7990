"""Sparse points for photos that come with poses but without points.

pycolmap finds SIFT features and triangulates. The matches in between need no estimation, because
the poses are known: they are mutual nearest neighbours that pass the ratio test and lie on each
other's epipolar line. Descriptors are integers whose products are exact in float32, so that the
points are the same for any number of threads. A child process does the work, so that its memory is
free when training begins.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import read_image
from clgs.data.lens import Lens
from clgs.data.masks import read_mask, save_mask
from clgs.data.posed_photo import Photo, from_plain, to_plain
from clgs.data.view import FOLDER, forget_oldest
from clgs.errors import ClgsError, DataError
from clgs.files import atomic_path, cache_folder, make_folder, text_bytes
from clgs.poses.evidence import sampson_error
from clgs.poses.pycolmap_child import SEEDS, OnStage, quiet_pycolmap, run_child
from clgs.scene.storage import load_archive

Floats = npt.NDArray[np.float64]

SIFT_SIZE = 1600
"""Larger photos are reduced to this longer side before the search for features, pixels."""

MAX_FEATURES = 3072
NEIGHBOURS = 8
"""The photos, taken nearby in a similar direction, with which a photo is matched."""

MAX_VIEW_ANGLE = np.radians(60.0)
MAX_RATIO = 0.85
"""Largest distance of a match over that of the second best one."""

MAX_EPIPOLAR_ERROR = 3.0
"""Pixels at the size at which features were found."""

MAX_REPROJECTION_ERROR = 2.0
"""Points with a larger mean error are dropped, pixels at the size of the features."""

BATCH = 8
"""The least number of photos that are in memory at a time; more if there are more processors."""

_RESULT = "points.npz"
_VERSION = 1
"""Raised with every change of the results, so that no stale points are found in a cache."""


@dataclass(frozen=True)
class Points:
    """P triangulated points: position (P, 3) float64, world units; color (P, 3) uint8."""

    position: Floats
    color: npt.NDArray[np.uint8]


@dataclass(frozen=True)
class _Features:
    """Features of a photo.

    position: pinhole pixels (M, 2); descriptor: (M, 128) uint8; color: (M, 3) uint8.
    """

    position: Floats
    descriptor: npt.NDArray[np.uint8]
    color: npt.NDArray[np.uint8]


def triangulate(
    photos: list[Photo],
    folder: Path | None = None,
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Points:
    """Triangulate points that at least two of the ``photos`` see, at their given poses.

    The result is kept in ``folder`` and in the user's cache folder, under a name made from poses,
    lenses, contents of images, seed and pycolmap's version, and is read from there the next time.
    ``on_stage`` receives a line of text before long work begins.

    Raises:
        DataError: there are fewer than two photos, or pycolmap is missing or fails.
    """
    if len(photos) < 2:
        raise DataError("a single photo gives no depth")
    name = f"points-{_key(photos, seed)}.npz"
    own = () if folder is None else (folder / name,)
    cached = cache_folder() / FOLDER / name
    points = next(filter(None, map(_read, (*own, cached))), None)
    if points is None:
        on_stage(f"finding points in {len(photos)} photos")
        with tempfile.TemporaryDirectory(prefix="clgs-") as made:
            plain = [to_plain(photo) for photo in photos]
            run_child(__name__, "triangulation", [plain, made, seed], on_stage)
            with np.load(Path(made) / _RESULT, allow_pickle=False) as arrays:
                points = Points(arrays["position"], arrays["color"])
    for file in own:
        _write(file, points)
    with suppress(ClgsError, OSError):
        _write(cached, points)
        forget_oldest(cached.parent)
    return points


def _write(file: Path, points: Points) -> None:
    """Keep points in a file, unless it has some."""
    if _read(file) is None:
        make_folder(file.parent)
        with atomic_path(file) as temporary:
            np.savez(temporary, position=points.position, color=points.color)


def _key(photos: list[Photo], seed: int) -> str:
    """Make a name from everything that the points depend on."""
    of_pycolmap = "".join(one.version for one in distributions(name="pycolmap"))
    digest = hashlib.blake2b(f"{_VERSION} {of_pycolmap} {seed}".encode(), digest_size=10)
    for photo in photos:
        digest.update(text_bytes(f"{photo.name} {photo.lens}"))
        digest.update(np.vstack([photo.rotation, photo.translation]).tobytes())
        for file in filter(None, (photo.path, photo.mask)):
            digest.update(hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


def _read(file: Path) -> Points | None:
    """Read points; None if there are none or the file is damaged."""
    with suppress(OSError):
        os.utime(file)  # it is in use
    try:
        with file.open("rb") as opened, load_archive(opened) as arrays:
            position, color = arrays["position"], arrays["color"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    valid = position.ndim == 2 and position.shape[1:] == (3,) and color.shape == position.shape
    typed = position.dtype == np.float64 and color.dtype == np.uint8
    return Points(position, color) if valid and typed else None


def work(arguments: Any, on_stage: OnStage) -> None:
    """Be the child: write the points, in a canonical order, into a file in the given folder."""
    photos, folder = [from_plain(one) for one in arguments[0]], Path(arguments[1])
    seed = arguments[2] % SEEDS
    (folder / "grey").mkdir()
    (folder / "masks").mkdir()
    names = [f"{number:06d}.png" for number in range(len(photos))]
    features, size = [], max(BATCH, os.cpu_count() or 1)
    with quiet_pycolmap("triangulation") as pycolmap:
        for start in range(0, len(photos), size):
            batch = slice(start, start + size)
            features += _extract(pycolmap, photos[batch], names[batch], folder)
        on_stage("matching their features")
        posed = _write_database(pycolmap, photos, features, folder / "matches.db")
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1
        options.random_seed = seed
        options.triangulation.random_seed = seed
        options.extract_colors = False
        options.triangulation.ignore_two_view_tracks = False
        max_error = MAX_REPROJECTION_ERROR * max(_shrink(photo.lens) for photo in photos)
        options.mapper.filter_max_reproj_error = 2 * max_error
        (folder / "out").mkdir()
        on_stage("triangulating the matches")
        found = pycolmap.triangulate_points(
            posed, folder / "matches.db", folder, folder / "out", options=options
        )
        accurate = [point for point in found.points3D.values() if point.error <= max_error]
        colors = []
        for point in accurate:
            track = [(e.image_id, e.point2D_idx) for e in point.track.elements]
            seen = [features[image_id - 1].color[index] for image_id, index in track]
            colors.append(np.mean(seen, axis=0))
        position = np.array([point.xyz for point in accurate], np.float64).reshape(-1, 3)
    color = np.rint(np.array(colors).reshape(-1, 3)).astype(np.uint8)
    order = np.lexsort(position.T)
    np.savez(folder / _RESULT, position=position[order], color=color[order])


def _shrink(lens: Lens) -> float:
    """Compute the pixels of the photo per pixel of the image that is searched for features."""
    return max(1.0, max(lens.width, lens.height) / SIFT_SIZE)


def _extract(pycolmap: Any, photos: list[Photo], names: list[str], folder: Path) -> list[_Features]:
    """Find SIFT features of some photos, which are named ``names`` in the database."""
    colors, masked = [], any(photo.mask for photo in photos)
    for photo, name in zip(photos, names, strict=True):
        size = photo.lens.width, photo.lens.height
        pixels = read_image(photo.path, size)
        if masked:
            # All photos need one then; COLMAP scales them to the size of the image it searches.
            used = read_mask(photo.mask, size) if photo.mask else np.ones(size[::-1], np.uint8)
            save_mask(used, folder / "masks" / f"{name}.png")
        picture = Image.fromarray(pixels.color)
        picture.thumbnail((SIFT_SIZE, SIFT_SIZE), Image.Resampling.BOX)
        picture.convert("L").save(folder / "grey" / name, compress_level=1)
        colors.append(np.asarray(picture))
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = MAX_FEATURES
    options.sift.first_octave = 0
    options.sift.peak_threshold = 0.004
    reader = pycolmap.ImageReaderOptions()
    if masked:
        reader.mask_path = folder / "masks"
    pycolmap.extract_features(
        folder / "features.db",
        folder / "grey",
        image_names=names,
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )
    with pycolmap.Database.open(folder / "features.db") as database:
        return [
            _read_features(database, name, photo.lens, color)
            for name, photo, color in zip(names, photos, colors, strict=True)
        ]


def _read_features(database: Any, name: str, lens: Lens, image: npt.NDArray[np.uint8]) -> _Features:
    """Read features of an image, at the pixels where a pinhole would see them; image: (H, W, 3)."""
    image_id = database.read_image_with_name(name).image_id
    found = np.asarray(database.read_keypoints(image_id), np.float64)[:, :2]
    descriptor = np.array(database.read_descriptors(image_id).data, np.uint8)
    column, row = np.minimum(found.astype(np.int64), (image.shape[1] - 1, image.shape[0] - 1)).T
    full_size = found * (lens.width / image.shape[1], lens.height / image.shape[0])
    focal, centre = np.array([lens.fx, lens.fy]), np.array([lens.cx, lens.cy])
    if lens.distorted:
        full_size = lens.undistort((full_size - centre) / focal) * focal + centre
    return _Features(full_size, descriptor, image[row, column])


def _write_database(
    pycolmap: Any, photos: list[Photo], features: list[_Features], path: Path
) -> Any:
    """Write a COLMAP database of pinhole cameras, features and matches; ids count from 1.

    Returns:
        pycolmap's reconstruction of the same cameras at the given poses, without points.
    """
    posed = pycolmap.Reconstruction()
    with pycolmap.Database.open(path) as database:
        for number, (photo, feature) in enumerate(zip(photos, features, strict=True), 1):
            lens = photo.lens
            camera = pycolmap.Camera(
                model="PINHOLE",
                width=lens.width,
                height=lens.height,
                params=[lens.fx, lens.fy, lens.cx, lens.cy],
                camera_id=number,
            )
            image = pycolmap.Image(
                name=f"{number:06d}",
                keypoints=feature.position,
                camera_id=number,
                image_id=number,
            )
            database.write_camera(camera, True)
            database.write_image(image, True)
            database.write_keypoints(number, feature.position.astype(np.float32))
            posed.add_camera_with_trivial_rig(camera)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(photo.rotation), photo.translation)
            posed.add_image_with_trivial_frame(image, pose)
        for first, second in choose_pairs(photos):
            matches = _match(photos, features, first, second)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = matches
            database.write_matches(first + 1, second + 1, matches)
            database.write_two_view_geometry(first + 1, second + 1, geometry)
    return posed


def choose_pairs(photos: list[Photo], neighbours: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Choose pairs (i, j), i < j, of photos taken near each other in similar directions.

    Each is paired with its ``neighbours``; the directions differ by at most MAX_VIEW_ANGLE.
    Nearness is the distance, in units of the median distance, plus the angle in radians.
    """
    centres = np.array([photo.centre for photo in photos])
    axes = np.array([photo.rotation[2] for photo in photos])
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    angle = np.arccos(np.clip(axes @ axes.T, -1.0, 1.0))
    cost = distance / max(float(np.median(distance)), 1e-12) + angle
    cost[(angle > MAX_VIEW_ANGLE) | (distance <= 0)] = np.inf
    nearest = np.argsort(cost, axis=1, kind="stable")[:, :neighbours]
    pairs = {
        (min(i, j), max(i, j))
        for i, row in enumerate(nearest.tolist())
        for j in row
        if np.isfinite(cost[i, j])
    }
    return sorted(pairs)


def _match(
    photos: list[Photo], features: list[_Features], first: int, second: int
) -> npt.NDArray[np.uint32]:
    """Find matches (M, 2) of feature numbers that agree with the poses."""
    if min(len(features[first].position), len(features[second].position)) < 2:
        return np.empty((0, 2), np.uint32)
    descriptors = (features[i].descriptor.astype(np.float32) for i in (first, second))
    pairs = _nearest_both_ways(*descriptors)
    rays = [
        (features[i].position[pairs[:, side]] - (photos[i].lens.cx, photos[i].lens.cy))
        / (photos[i].lens.fx, photos[i].lens.fy)
        for side, i in enumerate((first, second))
    ]
    rotation = photos[second].rotation @ photos[first].rotation.T
    translation = photos[second].translation - rotation @ photos[first].translation
    error = sampson_error(rotation, translation, rays[0], rays[1])
    lens = photos[first].lens
    limit = MAX_EPIPOLAR_ERROR * _shrink(lens) / min(lens.fx, photos[second].lens.fx)
    return pairs[error <= limit].astype(np.uint32)


def _nearest_both_ways(
    first: npt.NDArray[np.float32], second: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """Find pairs (M, 2) of rows that are each other's nearest and pass the ratio test."""
    norm = float(np.linalg.norm(first, axis=1).mean() * np.linalg.norm(second, axis=1).mean())
    similarity = first @ second.T
    forward = similarity.argmax(axis=1)
    rows = np.arange(len(first))
    best = similarity[rows, forward]
    similarity[rows, forward] = -np.inf
    runner_up = similarity.max(axis=1)
    # Descriptors have equal lengths: squared distance is proportional to 1 - cosine.
    far = np.maximum(1.0 - runner_up / norm, 0.0)
    distinct = 1.0 - best / norm <= MAX_RATIO**2 * far
    pairs = np.stack([rows[distinct], forward[distinct]], axis=1)
    # Only the columns of these pairs are searched the other way; all would cost as much again.
    backward = (second[pairs[:, 1]] @ first.T).argmax(axis=1)
    return np.asarray(pairs[backward == pairs[:, 0]])
