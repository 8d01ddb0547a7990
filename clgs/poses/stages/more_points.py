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

from clgs.ops.match import upload
from clgs.poses.evidence import Evidence, sampson_error
from clgs.poses.stages.matching import MAX_RATIO, Matches, Pair, by_tiles, mutual_matches
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
        for first, second, matches in _match(workspace, database, model, pairs):
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
    workspace: Workspace, database: Any, model: Any, pairs: Sequence[Pair]
) -> Iterator[tuple[int, int, Matches]]:
    """Match pairs of images, by their numbers, by the features that have no point."""
    count = workspace.counter(STAGE, 0, len(pairs))
    for some in by_tiles(pairs):
        numbers = sorted({number for pair in some for number in pair})
        free, photos, rays = [], [], []
        for number in numbers:
            image = model.image(number)
            keypoints = np.asarray(database.read_keypoints(number), np.float64)
            used = image.get_observation_point2D_idxs()
            rows = np.setdiff1d(np.arange(len(keypoints), dtype=np.uint32), used)
            pixels = keypoints[rows, :2]
            free.append(rows)
            photos.append(database.read_descriptors(number).data[rows])
            rays.append(model.cameras[image.camera_id].cam_from_img(pixels))
        uploaded = upload(workspace.device, photos)
        local = [(numbers.index(first), numbers.index(second)) for first, second in some]
        matched = mutual_matches(workspace.device, uploaded, photos, local, MAX_RATIO)
        for (first, second), (a, b), match in zip(some, local, matched, strict=True):
            one, other = model.image(first), model.image(second)
            pose = other.cam_from_world() * one.cam_from_world().inverse()
            left, right = rays[a][match[:, 0]], rays[b][match[:, 1]]
            error = sampson_error(pose.rotation.matrix(), pose.translation, left, right)
            focal = min(model.cameras[i.camera_id].mean_focal_length() for i in (one, other))
            match = match[error * focal <= MAX_EPIPOLAR_ERROR]
            yield first, second, np.stack([free[a][match[:, 0]], free[b][match[:, 1]]], 1)
        count(len(some))
