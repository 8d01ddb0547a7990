"""Sparse points for photos that come with poses but without points.

SIFT features and the triangulation are pycolmap's. The matches in between need no estimation,
because the poses are known: mutual nearest neighbours that pass the ratio test and lie on each
other's epipolar line. Descriptors are integers whose products are exact in float32, so that the
points are the same for any number of threads. A process of its own does the work (``child``): its
memory is gone when training begins.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from clgs.data.images import read_image
from clgs.data.lens import Lens
from clgs.data.masks import read_mask, save_mask
from clgs.data.posed_photo import Photo
from clgs.errors import DataError
from clgs.files import atomic_path, make_folder
from clgs.poses.child import run_child, serve
from clgs.poses.judging.epipolar import sampson_error
from clgs.poses.pycolmap_lazy import SEEDS, quiet_pycolmap

Floats = npt.NDArray[np.float64]

SIFT_SIZE = 1600
"""Features are searched in images whose longer side is at most this many pixels."""

MAX_FEATURES = 3072
NEIGHBOURS = 8
"""Each photo is matched with so many photos taken nearby in a similar direction."""

MAX_VIEW_ANGLE = np.radians(60.0)
MAX_RATIO = 0.85
"""Largest distance of the best match over that of the second best."""

MAX_EPIPOLAR_ERROR = 3.0
"""Pixels at the size at which features were found."""

MAX_REPROJECTION_ERROR = 2.0
"""Points with a larger mean error are dropped, pixels at the size of the features."""

BATCH = 8
"""Photos that are in memory at a time, unless there are more processors."""

_RESULT = "points.npz"
_VERSION = 1
"""Raised with every change of the results, so that cached points are not stale."""


@dataclass(frozen=True)
class Points:
    """position (P, 3) float64 world units; color (P, 3) uint8."""

    position: Floats
    color: npt.NDArray[np.uint8]


@dataclass(frozen=True)
class _Features:
    """Of one photo: pinhole pixels (M, 2) float64, descriptors (M, 128) uint8, colors (M, 3)."""

    position: Floats
    descriptor: npt.NDArray[np.uint8]
    color: npt.NDArray[np.uint8]


def triangulate(
    photos: list[Photo],
    cache: Path | None = None,
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Points:
    """Points seen in at least two of the ``photos``, at their given poses.

    With ``cache`` (a folder) the result is kept there under a name made from poses, lenses, image
    contents and seed, and found again. ``on_stage`` is told before long work begins.

    Raises:
        DataError: there are fewer than two photos, or pycolmap is missing or fails.
    """
    if len(photos) < 2:
        raise DataError("a single photo tells no depth")
    file = None if cache is None else cache / f"points-{_key(photos, seed)}.npz"
    if file is not None and (cached := _read_cache(file)) is not None:
        return cached
    on_stage(f"finding points in {len(photos)} photos")
    with tempfile.TemporaryDirectory(prefix="clgs-") as folder:
        plain = [_plain(photo) for photo in photos]
        run_child(__name__, "triangulation", [plain, folder, seed], on_stage)
        with np.load(Path(folder) / _RESULT, allow_pickle=False) as arrays:
            points = Points(arrays["position"], arrays["color"])
    if file is not None:
        make_folder(file.parent)
        with atomic_path(file) as temporary:
            np.savez(temporary, position=points.position, color=points.color)
    return points


def main() -> None:
    """The process that does the work."""
    serve(_work)


def _work(arguments: Any, on_stage: Callable[[str], None]) -> None:
    plain, folder, seed = arguments
    points = _triangulate([_photo(one) for one in plain], Path(folder), seed, on_stage)
    np.savez(Path(folder) / _RESULT, position=points.position, color=points.color)


def _plain(photo: Photo) -> dict[str, Any]:
    """A photo as JSON can hold it, exactly."""
    arrays = {"rotation": photo.rotation.tolist(), "translation": photo.translation.tolist()}
    mask = None if photo.mask is None else str(photo.mask)
    files = {"path": str(photo.path), "mask": mask}
    return {"name": photo.name, "lens": asdict(photo.lens), **files, **arrays}


def _photo(plain: dict[str, Any]) -> Photo:
    lens: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in plain["lens"].items()
    }
    rotation, translation = (
        np.array(plain[name], np.float64) for name in ("rotation", "translation")
    )
    mask = None if plain["mask"] is None else Path(plain["mask"])
    return Photo(plain["name"], Path(plain["path"]), Lens(**lens), rotation, translation, mask)


def _triangulate(
    photos: list[Photo], folder: Path, seed: int, on_stage: Callable[[str], None]
) -> Points:
    with quiet_pycolmap("triangulation") as pycolmap:
        features = _extract(pycolmap, photos, folder)
        on_stage("matching their features")
        database = _write_database(pycolmap, photos, features, folder)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1
        options.random_seed = seed % SEEDS
        options.triangulation.random_seed = seed % SEEDS
        options.extract_colors = False
        options.triangulation.ignore_two_view_tracks = False
        scale = max(_shrink(photo.lens) for photo in photos)
        options.mapper.filter_max_reproj_error = 2 * MAX_REPROJECTION_ERROR * scale
        reconstruction = _posed_reconstruction(pycolmap, photos, features)
        (folder / "out").mkdir()
        on_stage("triangulating the matches")
        result = pycolmap.triangulate_points(
            reconstruction, database, folder, folder / "out", options=options
        )
        return _collect(result, features, MAX_REPROJECTION_ERROR * scale)


def _collect(reconstruction: Any, features: list[_Features], max_error: float) -> Points:
    """Accurate points in canonical order, each with its observations' mean color."""
    positions, colors = [], []
    for point in reconstruction.points3D.values():
        if point.error <= max_error:
            track = [(e.image_id, e.point2D_idx) for e in point.track.elements]
            seen = [features[image_id - 1].color[index] for image_id, index in track]
            positions.append(point.xyz)
            colors.append(np.mean(seen, axis=0))
    position = np.array(positions, np.float64).reshape(-1, 3)
    color = np.rint(np.array(colors).reshape(-1, 3)).astype(np.uint8)
    order = np.lexsort(position.T)
    return Points(position[order], color[order])


def _shrink(lens: Lens) -> float:
    """Pixels of the photo in one pixel of the image in which features are searched."""
    return max(1.0, max(lens.width, lens.height) / SIFT_SIZE)


def _extract(pycolmap: Any, photos: list[Photo], folder: Path) -> list[_Features]:
    """SIFT features of every photo, in order."""
    names = [f"{number:06d}.png" for number in range(len(photos))]
    (folder / "grey").mkdir()
    (folder / "masks").mkdir()
    features, size = [], max(BATCH, os.cpu_count() or 1)
    for start in range(0, len(photos), size):
        part = slice(start, start + size)
        features += _extract_batch(pycolmap, photos[part], names[part], folder)
    return features


def _extract_batch(
    pycolmap: Any, photos: list[Photo], names: list[str], folder: Path
) -> list[_Features]:
    """SIFT features of some photos, which are named ``names`` in the database."""
    colors, masked = [], any(photo.mask for photo in photos)
    for photo, name in zip(photos, names, strict=True):
        size = photo.lens.width, photo.lens.height
        pixels = read_image(photo.path, size)
        if masked:
            # All photos need one then; COLMAP brings them to the size of the image it searches.
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
    """Features of one image of the database, at the pixels at which a pinhole would see them."""
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
    pycolmap: Any, photos: list[Photo], features: list[_Features], folder: Path
) -> Path:
    """A COLMAP database of pinhole cameras, features and verified matches; ids count from 1."""
    path = folder / "matches.db"
    with pycolmap.Database.open(path) as database:
        for number, (photo, feature) in enumerate(zip(photos, features, strict=True), 1):
            database.write_camera(_camera(pycolmap, photo, number), True)
            image = pycolmap.Image(name=f"{number:06d}", camera_id=number, image_id=number)
            database.write_image(image, True)
            database.write_keypoints(number, feature.position.astype(np.float32))
        for first, second in choose_pairs(photos):
            matches = _match(photos, features, first, second)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = matches
            database.write_matches(first + 1, second + 1, matches)
            database.write_two_view_geometry(first + 1, second + 1, geometry)
    return path


def _camera(pycolmap: Any, photo: Photo, number: int) -> Any:
    lens = photo.lens
    return pycolmap.Camera(
        model="PINHOLE",
        width=lens.width,
        height=lens.height,
        params=[lens.fx, lens.fy, lens.cx, lens.cy],
        camera_id=number,
    )


def _posed_reconstruction(pycolmap: Any, photos: list[Photo], features: list[_Features]) -> Any:
    reconstruction = pycolmap.Reconstruction()
    for number, (photo, feature) in enumerate(zip(photos, features, strict=True), 1):
        reconstruction.add_camera_with_trivial_rig(_camera(pycolmap, photo, number))
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(photo.rotation), photo.translation)
        image = pycolmap.Image(
            name=f"{number:06d}",
            keypoints=feature.position,
            camera_id=number,
            image_id=number,
        )
        reconstruction.add_image_with_trivial_frame(image, pose)
    return reconstruction


def choose_pairs(photos: list[Photo]) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of photos taken near each other in directions within MAX_VIEW_ANGLE.

    Near counts distance, in units of the median distance, plus the angle in radians.
    """
    centres = np.array([photo.centre for photo in photos])
    axes = np.array([photo.rotation[2] for photo in photos])
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    angle = np.arccos(np.clip(axes @ axes.T, -1.0, 1.0))
    cost = distance / max(float(np.median(distance)), 1e-12) + angle
    cost[(angle > MAX_VIEW_ANGLE) | (distance <= 0)] = np.inf
    nearest = np.argsort(cost, axis=1, kind="stable")[:, :NEIGHBOURS]
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
    """Matches (M, 2) of feature numbers that agree with the poses."""
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
    """Pairs (M, 2) of rows that are each other's nearest and pass the ratio test."""
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
    # Only the columns that matter are searched the other way: the whole would cost as much again.
    backward = (second[pairs[:, 1]] @ first.T).argmax(axis=1)
    return np.asarray(pairs[backward == pairs[:, 0]])


def _key(photos: list[Photo], seed: int) -> str:
    """A name for everything that the points depend on."""
    digest = hashlib.blake2b(f"{_VERSION} {seed}".encode(), digest_size=10)
    for photo in photos:
        digest.update(f"{photo.name} {photo.lens}".encode())
        digest.update(np.vstack([photo.rotation, photo.translation]).tobytes())
        for file in filter(None, (photo.path, photo.mask)):
            digest.update(hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


def _read_cache(file: Path) -> Points | None:
    """The cached points, or None if there are none or the file is damaged."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
            position, color = arrays["position"], arrays["color"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    valid = position.ndim == 2 and position.shape[1:] == (3,) and color.shape == position.shape
    typed = position.dtype == np.float64 and color.dtype == np.uint8
    return Points(position, color) if valid and typed else None
