"""Start points from a file: any point cloud or mesh of a format that trimesh reads by itself."""

from __future__ import annotations

import io
import json
import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.posed_photo import to_y_up
from clgs.errors import DataError
from clgs.scene.world import LOCAL

Floats = npt.NDArray[np.float64]

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
        kind: of the data set: "blender", "transforms" or "colmap".
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
    with _quiet():
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


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what trimesh logs about a file from the user, who gets one line."""
    logger = logging.getLogger("trimesh")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
