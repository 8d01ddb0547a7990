"""GLB files, which 3-D viewers open: cameras and start points of a data set; ordinary Gaussians.

The Gaussians have the extension KHR_gaussian_splatting: one primitive of points with float32
attributes: positions, rotations (x y z w), scales (not their logarithms), opacities in [0, 1], and
every coefficient of the color as a vector of three; COLOR_0 is for viewers that show plain points.
glTF has y up: the node turns the data set's axes to that, the attributes stay in them. It also
moves splats that lie far from the origin to their place.

Source: the specification of the extension at Khronos (github.com/KhronosGroup/glTF).
"""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import Dataset
from clgs.data.posed_photo import to_y_up
from clgs.exports.splats.ply import Encoded, file_units, scene_units
from clgs.scene.gaussians import SH_0, HostGaussians, sigmoid, unit_rotation
from clgs.scene.scene import IDENTITY, SceneTransform
from clgs.scene.world import to_text

FRUSTUM_DEPTH = 0.1
"""Length of a frustum in camera radii."""

LARGEST = np.float32(88.7)
"""The logarithm of the largest scale: that of more is no float32."""
POINT_COLOR = (128, 128, 128, 255)
CAMERA_COLORS = {"train": (40, 90, 220, 255), "test": (230, 120, 20, 255)}
"""RGBA."""

EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))
"""The edges of a frustum: corner 0 is the camera's centre, 1 to 4 go around the picture."""


def cameras_glb(dataset: Dataset) -> bytes:
    """A GLB file with the data set's points and a frustum of lines per camera.

    Lengths are the data set's world units; the axes are turned so that y is up, as glTF has it
    (``clgs.data.posed_photo.to_y_up``). There is a node "points" if there are points, and a node
    "train/NAME" or "test/NAME" per photo, whose matrix is the camera's pose: x right, y down,
    z forward.
    """
    import trimesh
    from trimesh.path import Path3D
    from trimesh.path.entities import Line

    turn = to_y_up(dataset.kind, dataset.transform.frame)
    depth = FRUSTUM_DEPTH * dataset.radius / dataset.transform.scale
    scene = trimesh.Scene(base_frame="world")
    if len(dataset.points):
        world = dataset.transform.to_world(dataset.points.astype(np.float64)) @ turn.T
        colors = np.full((len(world), 4), POINT_COLOR, np.uint8)
        if dataset.point_colors is not None:
            colors[:, :3] = dataset.point_colors
        cloud = trimesh.PointCloud(world, colors=colors)
        scene.add_geometry(cloud, node_name="points", geom_name="points")
    for split, views in (("train", dataset.train), ("test", dataset.test)):
        for view in views:
            # the frustum's edges in the camera's axes, as lines
            camera = view.camera
            picture = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (camera.width, camera.height)
            flat = (picture - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
            corners = depth * np.column_stack([flat, np.ones(4)])
            lines = [Line(list(edge)) for edge in EDGES]
            frustum = Path3D(
                lines,
                np.vstack([np.zeros(3), corners]),
                colors=[CAMERA_COLORS[split]] * len(EDGES),
                process=False,
            )
            pose = np.eye(4)  # camera to turned world
            pose[:3, :3] = turn @ camera.rotation.T
            pose[:3, 3] = turn @ dataset.transform.to_world(camera.centre[None])[0]
            name = f"{split}/{view.name}"
            scene.add_geometry(frustum, node_name=name, geom_name=name, transform=pose)
    return bytes(scene.export(file_type="glb"))


EXTENSION = "KHR_gaussian_splatting"
SPACE = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
    "sortingMethod": "cameraDistance",
}
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
FLOAT, UNSIGNED_BYTE, ARRAY_BUFFER, POINTS = 5126, 5121, 34962, 0


def encode_glb(
    gaussians: HostGaussians,
    transform: SceneTransform = IDENTITY,
    turn: npt.NDArray[np.float64] | None = None,
) -> Encoded:
    """The file of N Gaussians.

    Args:
        gaussians: in scene units.
        transform: the world's units, which the file has.
        turn: rotation (3, 3) from their axes to glTF's; default: none.
    """
    position, log_scale, origin = file_units(gaussians, transform)
    near = (position - origin).astype(np.float32)
    attributes = _attributes(replace(gaussians, mean=near, log_scale=log_scale))
    binary = b"".join(values.tobytes() for values in attributes.values())
    binary += b"\0" * (-len(binary) % 4)
    offset = 0
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    for values in attributes.values():
        width = values.shape[1] if values.ndim > 1 else 1
        place = {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes}
        views.append(place | {"target": ARRAY_BUFFER})
        accessor = {"bufferView": len(accessors), "count": len(values), "type": TYPES[width]}
        accessor["componentType"] = FLOAT if values.dtype == np.float32 else UNSIGNED_BYTE
        if values.dtype == np.uint8:
            accessor["normalized"] = True
        accessors.append(accessor)
        offset += values.nbytes
    accessor = accessors[list(attributes).index("POSITION")]
    accessor["min"] = [float(x) for x in near.min(axis=0)]
    accessor["max"] = [float(x) for x in near.max(axis=0)]
    node: dict[str, Any] = {"mesh": 0}
    if turn is not None or origin.any():
        matrix = np.eye(4)
        matrix[:3, :3] = np.eye(3) if turn is None else turn
        matrix[:3, 3] = matrix[:3, :3] @ origin
        node["matrix"] = [float(x) + 0.0 for x in matrix.T.ravel()]  # no negative zeros
    primitive: dict[str, Any] = {
        "attributes": {name: i for i, name in enumerate(attributes)},
        "mode": POINTS,
        "extensions": {EXTENSION: SPACE},
    }
    if gaussians.antialiased:  # the extension has no word for it
        primitive["extras"] = {"antialiased": True}
    asset: dict[str, Any] = {"version": "2.0", "generator": "clgs"}
    if world := to_text(transform.frame, transform.place):
        asset["extras"] = {"world": world}
    document = {
        "asset": asset,
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = b"".join(
        struct.pack("<I4s", len(chunk), kind) + chunk
        for kind, chunk in ((b"JSON", text), (b"BIN\0", binary))
    )
    data = struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
    return Encoded(data, scene_units(gaussians, near + origin, log_scale, transform))


def _attributes(gaussians: HostGaussians) -> dict[str, npt.NDArray[Any]]:
    """Every attribute by name, C-contiguous, rows of a multiple of 4 bytes."""
    opacity = sigmoid(gaussians.opacity)
    rotation = unit_rotation(gaussians.rotation)
    color = np.column_stack([gaussians.sh[:, 0] * SH_0 + 0.5, opacity])
    found: dict[str, npt.NDArray[Any]] = {
        "POSITION": gaussians.mean,
        "COLOR_0": np.rint(255 * np.clip(color, 0, 1)).astype(np.uint8),
        f"{EXTENSION}:ROTATION": rotation[:, [1, 2, 3, 0]].astype("<f4"),
        f"{EXTENSION}:SCALE": np.exp(np.minimum(gaussians.log_scale, LARGEST)),
        f"{EXTENSION}:OPACITY": opacity.astype("<f4"),
    }
    for number in range(gaussians.sh.shape[1]):
        degree = int(np.sqrt(number))
        name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number - degree**2}"
        found[name] = gaussians.sh[:, number]
    return {name: np.ascontiguousarray(values) for name, values in found.items()}
