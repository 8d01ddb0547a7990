"""Start points: from a file, or random ones for a data set without points.

The file is any point cloud or mesh of a format that trimesh reads by itself.
"""

from __future__ import annotations

import io
import json
import logging
import math
import re
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.posed_photo import to_y_up
from clgs.errors import DataError
from clgs.machine import processors
from clgs.scene.camera import Camera
from clgs.scene.world import LOCAL

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

BLENDER_HALF_EDGE = 1.3
"""Half the edge of the cube around the origin that holds every Synthetic-NeRF object."""

BLENDER_DISTANCE, BLENDER_TOLERANCE = 4.0, 1.5
"""How far the cameras of Synthetic-NeRF are from the origin. Scenes that are smaller or larger by
more than the tolerance are scaled to that."""

HULL_POINTS = 30_000
"""Random points in the visual hull of a Blender scene; anchors grow from there."""

LONG_RUN_POINTS = 10_000
"""How many of them a run of LONG_RUN steps begins with: growth has time to find others there."""

SHORT_RUN, LONG_RUN = 3_000, 30_000
"""Runs of this many steps, and shorter ones, begin with all of them; in between they are fewer."""

SURFACE_SHARE = 0.5
"""The most of them that lie near its surface, as a share, if photos have a background: most of what
photos show is there, and the rest may lie in hollows that no outline shows."""

SURFACE_DEPTH = 0.02
"""How near that is along an axis, as a share of the longest side of the hull."""

DRAWN_PER_POINT = 2
"""Points that are drawn for each one, so that many of them lie near the surface."""

RAY_POINTS = 100_000
"""Random points among photos, most of them in empty space."""

SEEN_SHARE = 0.5
"""A random point must lie in the image of at least this share of the cameras; if none does, as in a
room photographed from its middle, of two cameras."""

MASK_MARGIN = 2
"""Pixels by which alpha masks are grown before points are carved with them."""

_BATCH = 200_000
_MAX_BATCHES = 20


Viewpoint = tuple[Camera, Mask | None]
"""A camera and, if its image has alpha, the grown mask (H, W) of what is not background."""


def grown_mask(alpha: npt.NDArray[np.uint8] | None) -> Mask | None:
    """Where alpha (H, W) is above 0, grown by MASK_MARGIN pixels."""
    if alpha is None:
        return None
    from scipy.ndimage import maximum_filter  # not needed by most data sets

    return np.asarray(maximum_filter(alpha, size=2 * MASK_MARGIN + 1) > 0)


def hull_points(looks: int) -> int:
    """How many HULL_POINTS a run that looks at this many views begins with."""
    power = math.log(HULL_POINTS / LONG_RUN_POINTS) / math.log(LONG_RUN / SHORT_RUN)
    wanted = round(HULL_POINTS * math.pow(SHORT_RUN / looks, power))
    return max(LONG_RUN_POINTS, min(wanted, HULL_POINTS))


def random_points(
    viewpoints: list[Viewpoint], radius: float, blender: bool, seed: int, count: int, carved: bool
) -> npt.NDArray[np.float32]:
    """About ``count`` points (P, 3) float32 in the volume that the cameras share.

    A point is kept if at least SEEN_SHARE of the cameras, or else two of them, have it in their
    image and none of those shows background there; P is 0 if there is none. ``blender``: drawn
    in the cube of Synthetic-NeRF, unless no camera sees it; else along random viewing rays at
    depths of 0.2 to 5 times ``radius``. Scene units. ``count`` 0: HULL_POINTS in Blender scenes,
    RAY_POINTS among photos. Not ``carved``, the points of a Blender scene fill its cube,
    background or not (Voxel-GS).
    """
    rng = np.random.default_rng(seed)
    count = count or (HULL_POINTS if blender else RAY_POINTS)
    if blender and not carved:
        edge = BLENDER_HALF_EDGE
        return rng.uniform(-edge, edge, (count, 3)).astype(np.float32)
    most = math.ceil(SEEN_SHARE * len(viewpoints))
    points = _in_hull(rng, viewpoints, most, count) if blender else np.empty((0, 3))
    for needed in (most, min(2, most)):
        if not len(points):
            draw = partial(_on_rays, rng, viewpoints, radius)
            points = _collect(draw, viewpoints, needed, count)
    return points[:count].astype(np.float32)


NEIGHBOURS = 3
"""Points are added between a point and this many of those nearest to it."""

MOST_APART = 2.5
"""Neighbours are near if they are no further apart than this many times the distance of either to
the one nearest to it: what lies further off is another thing."""


def filled(points: npt.NDArray[np.floating], count: int, seed: int) -> npt.NDArray[np.floating]:
    """``points`` (P, 3) and others in the middle between near ones, until there are ``count``.

    Fewer if there are not as many pairs of neighbours; which of these is drawn by ``seed``. Points
    that are added to are distinct and in order. Those that are not finite are none to add to.
    """
    if len(points) >= count or not np.isfinite(points).all():
        return points
    from scipy.spatial import cKDTree  # not needed by most data sets

    rng, before = np.random.default_rng(seed), 0
    points = _distinct(points)
    while NEIGHBOURS < len(points) < count and len(points) > before:
        before = len(points)
        tree, spacing = cKDTree(points), np.empty(before)
        order = tree.indices  # one leaf after the other: a query finds much in the cache
        distance, near = tree.query(points[order], k=NEIGHBOURS + 1, workers=processors())
        spacing[order] = distance[:, 1]
        first, second = np.repeat(order, NEIGHBOURS), near[:, 1:].ravel()
        close = distance[:, 1:].ravel() <= MOST_APART * np.maximum(spacing[first], spacing[second])
        least, greatest = np.minimum(first, second)[close], np.maximum(first, second)[close]
        pairs = np.sort(least * before + greatest)
        pairs = pairs[np.diff(pairs, prepend=-1) > 0]
        drawn = np.sort(rng.permutation(len(pairs))[: count - before])
        ends = np.stack(np.divmod(pairs[drawn], before), 1)
        points = _distinct(np.concatenate([points, points[ends].mean(axis=1)]))
    return points


def _distinct(points: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Points (P, 3), each once, ascending by (x, y, z); np.unique takes much longer."""
    points = points[np.lexsort(points.T[::-1])]
    return np.compress(np.append(True, (points[1:] != points[:-1]).any(1)), points, axis=0)


def _collect(
    draw: Callable[[], Floats], viewpoints: list[Viewpoint], needed: int, count: int
) -> Floats:
    """Batches of ``draw`` carved until ``count`` are left, or none ever is."""
    kept: list[Floats] = []
    for _ in range(_MAX_BATCHES):
        points = draw()
        kept.append(points[_shared(points, viewpoints, needed)])
        found = sum(map(len, kept))
        if found == 0 or found >= count:
            break
    return np.concatenate(kept)


def _in_hull(
    rng: np.random.Generator, viewpoints: list[Viewpoint], needed: int, count: int
) -> Floats:
    """Points of :func:`_in_cube`, more of them near the surface of the volume that they fill."""
    if all(mask is None for _, mask in viewpoints):
        return _in_cube(rng, viewpoints, needed, count)
    points = _in_cube(rng, viewpoints, needed, DRAWN_PER_POINT * count)
    if not len(points):
        return points
    depth = SURFACE_DEPTH * np.ptp(points, axis=0).max()
    near = np.zeros(len(points), np.bool_)
    for shift in depth * np.concatenate([np.eye(3), -np.eye(3)]):
        near |= ~_shared(points + shift, viewpoints, needed)
    kept = np.zeros(len(points), np.bool_)
    kept[np.flatnonzero(near)[: int(SURFACE_SHARE * count)]] = True
    kept[np.flatnonzero(~kept)[: count - np.count_nonzero(kept)]] = True
    return points[kept]


def _in_cube(
    rng: np.random.Generator, viewpoints: list[Viewpoint], needed: int, count: int
) -> Floats:
    """Points of the cube of Synthetic-NeRF; after a first look only of the part that is full."""
    low, high = np.full(3, -BLENDER_HALF_EDGE), np.full(3, BLENDER_HALF_EDGE)
    first = rng.uniform(low, high, (_BATCH, 3))
    first = first[_shared(first, viewpoints, needed)]
    if not len(first):
        return first
    margin = 0.05 * (first.max(axis=0) - first.min(axis=0)) + 0.01
    low = np.maximum(low, first.min(axis=0) - margin)
    high = np.minimum(high, first.max(axis=0) + margin)
    return _collect(lambda: rng.uniform(low, high, (_BATCH, 3)), viewpoints, needed, count)


def _on_rays(rng: np.random.Generator, viewpoints: list[Viewpoint], radius: float) -> Floats:
    """Points of random pixels of random cameras, depth log-uniform."""
    depth = radius * np.exp(rng.uniform(np.log(0.2), np.log(5.0), _BATCH))
    owner = rng.integers(len(viewpoints), size=_BATCH)
    pixel = rng.uniform(size=(_BATCH, 2))
    points = np.empty((_BATCH, 3))
    for number, (camera, _) in enumerate(viewpoints):
        mine = owner == number
        at = pixel[mine] * (camera.width, camera.height)
        ray = (at - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        local = np.column_stack([ray, np.ones(len(ray))]) * depth[mine, None]
        points[mine] = (local - camera.translation) @ camera.rotation
    return points


def _shared(points: Floats, viewpoints: list[Viewpoint], needed: int) -> Mask:
    """Which points (P, 3) ``needed`` cameras see and none sees through."""
    alive = np.arange(len(points))
    seen = np.zeros(len(points), np.int64)
    for camera, mask in viewpoints:
        # whether points (P, 3) fall into the image, and the column and row (P,) of those that do
        local = points[alive] @ camera.rotation.T + camera.translation
        ahead = local[:, 2] > 1e-6
        depth = np.where(ahead, local[:, 2], 1.0)
        x = local[:, 0] / depth * camera.fx + camera.cx
        y = local[:, 1] / depth * camera.fy + camera.cy
        inside = ahead & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        column = np.where(inside, x, 0.0).astype(np.int64)
        row = np.where(inside, y, 0.0).astype(np.int64)
        seen[alive] += inside
        if mask is not None:
            alive = alive[~inside | mask[row, column]]
    kept = np.zeros(len(points), bool)
    kept[alive] = seen[alive] >= needed
    return kept


SUFFIXES = (".ply", ".obj", ".glb", ".stl", ".off", ".xyz")
"""Formats of one file each, which trimesh reads without other libraries."""

MAX_BYTES = 1 << 30
"""A larger file is refused: its arrays would take several times as much memory."""

MAX_ELEMENTS = 100_000_000
"""Vertices and faces of all copies of all meshes of a file."""

MAX_PLY_HEADER = 1 << 16
_GLB_HEADER = 20
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_SHARING = 8
"""Times that the arrays of a GLB file, which may share bytes, may be larger than the file."""


def read_points(path: Path, samples: int, kind: str, seed: int, frame: int = LOCAL) -> Floats:
    """The points of a file, (P, 3) float64 in the world units of the data set.

    All points of clouds are taken, and samples of the surfaces of meshes, spread evenly by area;
    lines and colors are ignored. GLB files, whose y is up, are turned to the data set's axes.

    Args:
        path: its suffix, one of SUFFIXES, names the format.
        samples: points that are drawn on the surfaces, if the file has any.
        kind: of the data set: "blender", "transforms", "colmap", or the program that made it.
        seed: of the samples.
        frame: of the data set's world, as of SceneTransform.

    Raises:
        DataError: missing, empty, too large, damaged, or no such format; names the file.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise DataError(
            f"{path}: has no known format by its name; convert it to {', '.join(SUFFIXES[:-1])} or "
            f"{SUFFIXES[-1]}"
        )
    data = _read(path)
    try:
        points = _parse(data, path.suffix.lower(), samples, seed)
    except Exception as error:  # the parsers of trimesh raise many classes
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise DataError(f"{path}: is damaged ({reason}); export it again") from error
    if not len(points):
        raise DataError(f"{path}: holds neither points nor surfaces; name another file")
    return points @ to_y_up(kind, frame) if path.suffix.lower() == ".glb" else points


def _read(path: Path) -> bytes:
    if not path.exists():
        raise DataError(f"{path}: no such file; name a point cloud or a mesh")
    if not path.is_file():
        raise DataError(f"{path}: is no regular file; name a point cloud or a mesh")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if not data:
        raise DataError(f"{path}: is empty; name a point cloud or a mesh")
    if len(data) > MAX_BYTES:
        raise DataError(f"{path}: has more than {MAX_BYTES >> 20} MiB; thin it out")
    return data


def _parse(data: bytes, suffix: str, samples: int, seed: int) -> Floats:
    """The points in the file's own axes; errors of trimesh of all classes pass through."""
    import trimesh

    if suffix == ".glb":
        _check_glb(data)
    logger = logging.getLogger("trimesh")
    with ExitStack() as quiet:  # the user gets one line in place of what it logs
        quiet.callback(logger.setLevel, logger.level)
        logger.setLevel(logging.CRITICAL)
        # Without a resolver, a file cannot name others that are read with it.
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True
        )
        if suffix == ".ply":
            found = sum(len(one.vertices) for one in scene.geometry.values())
            declared = re.search(rb"\nelement\s+vertex\s+(\d{1,18})\s", data[:MAX_PLY_HEADER])
            if declared and found < int(declared[1]):  # text may be cut
                raise ValueError(
                    f"{found} vertices follow the header, which promises {int(declared[1])}"
                )
        clouds, corners = _gather(scene)
        if suffix == ".stl" and not len(corners):
            raise ValueError("no triangles")  # some versions of trimesh read noise as none
        return np.concatenate([*clouds, _sample(corners, samples, seed)])


def _gather(scene: Any) -> tuple[list[Floats], Floats]:
    """Points of every cloud, and the corners (T, 3, 3) of all triangles, in place."""
    clouds: list[Floats] = [np.empty((0, 3))]
    corners: list[Floats] = [np.empty((0, 3, 3))]
    elements = 0
    for node in sorted(scene.graph.nodes_geometry):
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        vertices, faces = np.asarray(geometry.vertices), getattr(geometry, "faces", None)
        if hasattr(geometry, "entities") or vertices.ndim != 2 or vertices.shape[1] != 3:
            continue  # lines
        elements += len(vertices) + (0 if faces is None else len(faces))
        if elements > MAX_ELEMENTS:
            raise ValueError(f"it has more than {MAX_ELEMENTS} vertices and faces")
        placed = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        if faces is None:
            clouds.append(placed)
        else:
            corners.append(placed[np.asarray(faces)].reshape(-1, 3, 3))
    return clouds, np.concatenate(corners)


def _sample(corners: Floats, samples: int, seed: int) -> Floats:
    """Points (samples, 3) on triangles (T, 3, 3), spread evenly by area; none without an area."""
    import trimesh
    from trimesh.sample import sample_surface

    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    usable = np.isfinite(area) & (area > 0)
    if not usable.any():
        return np.empty((0, 3))
    corners, area = corners[usable], area[usable]
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    return np.asarray(sample_surface(mesh, samples, face_weight=area, seed=seed)[0], np.float64)


def _check_glb(data: bytes) -> None:
    """Raise ValueError if the arrays that the header declares cannot be in the file."""
    length = int.from_bytes(data[12:16], "little")
    if data[:4] != b"glTF" or data[16:20] != b"JSON" or length > len(data) - _GLB_HEADER:
        raise ValueError("no GLB header")
    header = json.loads(data[_GLB_HEADER : _GLB_HEADER + length])
    needed = sum(
        int(one["count"]) * _COMPONENTS[one["type"]] * _COMPONENT_BYTES[one["componentType"]]
        for one in header.get("accessors", ())
    )
    if needed > _SHARING * len(data):
        raise ValueError(f"its header promises {needed} bytes")
