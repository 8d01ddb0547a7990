"""More points for a model, of features that matching left out.

The model's poses replace the estimation of geometries: a match of two features must lie on both
epipolar lines.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.poses.evidence import Evidence, sampson_error
from clgs.poses.stages.matching import MAX_RATIO, Matches, Pair, match_by_tiles
from clgs.poses.triangulate import MAX_REPROJECTION_ERROR
from clgs.poses.workspace import Workspace

NEIGHBOURS = 2
"""Each photo is matched with this number of others: those with which it has the most matches."""

MAX_EPIPOLAR_ERROR = 2.0
"""Pixels."""

STAGE = "points"


def add_points(workspace: Workspace, model: Any, evidence: Evidence) -> Any:
    """Match the features that have no point between neighbouring photos, and add their points.

    ``model``: pycolmap's reconstruction, which is returned; its poses, cameras and points stay as
    they are.

    Raises:
        DeviceError: the device fails.
    """
    pycolmap, folder = workspace.pycolmap, workspace.folder / STAGE
    (folder / "out").mkdir(parents=True)
    model.write(folder)
    small = replace(workspace, folder=folder)
    shutil.copyfile(workspace.database, small.database)
    with small.open() as database:
        database.clear_matches()
        database.clear_two_view_geometries()
        placed = {number: model.image(number) for number in model.reg_image_ids()}
        pairs = [
            (pair.first, pair.second)
            for pair in evidence.strongest(NEIGHBOURS)
            if pair.first in placed and pair.second in placed
        ]
        for (first, second), matches in _match(workspace, database, model, evidence, pairs):
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = matches
            database.write_matches(first, second, matches)
            database.write_two_view_geometry(first, second, geometry)
    options = workspace.pipeline_options()
    options.triangulation.ignore_two_view_tracks = False
    posed = pycolmap.Reconstruction(folder)
    found = workspace.call(
        pycolmap.triangulate_points,
        *(posed, small.database, workspace.images, folder / "out"),
        options=options,
    )
    for number in sorted(found.point3D_ids()):
        point = found.point3D(number)
        if point.error <= MAX_REPROJECTION_ERROR:
            model.add_point3D(point.xyz, point.track, point.color)
    model.update_point_3d_errors()
    return model


def _match(
    workspace: Workspace, database: Any, model: Any, evidence: Evidence, pairs: Sequence[Pair]
) -> Iterator[tuple[Pair, Matches]]:
    """Match pairs of images, by their numbers, by the features that have no point."""

    def read(number: int) -> tuple[Matches, npt.NDArray[np.uint8]]:
        every = np.arange(len(evidence.keypoints[number]), dtype=np.uint32)
        rows = np.setdiff1d(every, model.image(number).get_observation_point2D_idxs())
        return rows, database.read_descriptors(number).data[rows]

    count = workspace.counter(STAGE, 0, len(pairs))
    for pair, match in match_by_tiles(workspace.device, pairs, read, MAX_RATIO, count):
        images = [model.image(number) for number in pair]
        cameras = [model.cameras[image.camera_id] for image in images]
        first, second = (image.cam_from_world() for image in images)
        pose = second * first.inverse()
        left, right = (
            camera.cam_from_img(evidence.keypoints[number][rows])
            for number, camera, rows in zip(pair, cameras, match.T, strict=True)
        )
        error = sampson_error(pose.rotation.matrix(), pose.translation, left, right)
        focal = min(camera.mean_focal_length() for camera in cameras)
        yield pair, match[error * focal <= MAX_EPIPOLAR_ERROR]
