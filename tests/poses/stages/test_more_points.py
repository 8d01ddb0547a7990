"""Features that matching left out become points where the scene is, and move nothing else."""

from pathlib import Path

import numpy as np
import pytest

from clgs.poses.evidence import Poses, common_similarity, poses_of
from clgs.poses.stages import matching
from clgs.poses.stages.mapping import map_photos
from clgs.poses.stages.more_points import MAX_REPROJECTION_ERROR, add_points
from clgs.poses.stages.pairs import pairs_to_match
from tests.data.folders import room_poses
from tests.poses.stages.room import room_workspace

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

PHOTOS = 8
LARGEST = 200
"""Features of a photo by which the first model is made."""


@pytest.mark.slow
def test_points_are_added_on_the_walls_of_a_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(matching, "MAX_FULL", 0)
    monkeypatch.setattr(matching, "ENOUGH_MATCHES", 0)
    truth, progress = room_poses(PHOTOS), []
    with room_workspace(tmp_path, PHOTOS, lambda *step: progress.append(step)) as workspace:
        assert matching.match(workspace, pairs_to_match(workspace), LARGEST)
        choice = map_photos(workspace, matching.read_evidence(workspace), quick=True)
        model = choice.kept.reconstruction
        before = {number: (point.xyz, point.track) for number, point in model.points3D.items()}
        poses = poses_of(model)
        add_points(workspace, model, choice.evidence)
    after = poses_of(model)
    assert np.array_equal(poses.rotation, after.rotation)
    assert np.array_equal(poses.centre, after.centre)
    stage, done, total = progress[-1]
    assert stage == "points"
    assert done == total > 0
    assert all(
        np.array_equal(model.point3D(number).xyz, xyz) for number, (xyz, _) in before.items()
    )
    added = [point for number, point in model.points3D.items() if number not in before]
    assert len(added) > len(before) > 50
    used = [
        (e.image_id, e.point2D_idx)
        for point in model.points3D.values()
        for e in point.track.elements
    ]
    assert len(used) == len(set(used))
    assert all(point.error <= MAX_REPROJECTION_ERROR for point in added)
    rotation = np.array([pose[:3, :3].T for pose in truth])
    centre = np.array([pose[:3, 3] for pose in truth])
    world = common_similarity(after, Poses(workspace.names, rotation, centre, np.ones(PHOTOS)))
    placed = np.array([point.xyz for point in added])
    placed = world.scale * placed @ world.turn.T + world.offset
    assert np.quantile(np.abs(placed).min(axis=1), 0.95) < 0.05
