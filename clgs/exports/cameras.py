"""The cameras and start points of a data set as a GLB file, which 3-D viewers open."""

from __future__ import annotations

import numpy as np

from clgs.data.dataset import Dataset
from clgs.data.posed_photo import to_y_up

FRUSTUM_DEPTH = 0.1
"""Length of a frustum in camera radii."""

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
