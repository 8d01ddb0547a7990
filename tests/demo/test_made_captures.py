"""Poses of a made room with a repeated pattern, against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clgs.data.colmap.model import read_colmap
from clgs.poses.judging.agreement import Poses, differences
from clgs.poses.judging.evidence import MAX_CONTRADICTED
from clgs.poses.judging.verdict import GOOD
from clgs.poses.prepare import prepare


def poses(views) -> Poses:
    """Poses of photos (name, rotation, centre); depth as of the room."""
    names, rotation, centre = zip(*views, strict=True)
    return Poses(list(names), np.array(rotation), np.array(centre), np.full(len(names), 3.0))


@pytest.mark.slow
def test_poses_of_the_room_are_right_or_doubted(tmp_path: Path):
    pytest.importorskip("embreex")
    pytest.importorskip("skimage")
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    import made_captures

    taken = made_captures.photograph("room", tmp_path / "room")
    # Of this seed the model of all pairs lays one side of the room onto another on some machines.
    verdict = prepare(tmp_path / "room", tmp_path / "data", seed=4)
    photos = read_colmap(tmp_path / "data", tmp_path / "data" / "sparse" / "0")
    found = [(one.name, one.rotation, one.centre) for one in [*photos.train, *photos.test]]
    true = [(name, view.rotation, view.centre) for name, view in taken.items()]
    good = {one.name for one in verdict.of(GOOD)}
    assert verdict.registered >= 0.9 * len(taken)
    assert verdict.contradicted <= MAX_CONTRADICTED
    assert len(good) >= len(taken) / 3  # the walls are equal on purpose: many are doubted
    different = differences(poses(true), poses(found))
    assert {name for name, one in different.items() if one.turn > 1.0} <= set(taken) - good


@pytest.mark.slow
def test_no_pose_of_the_tower_is_called_good_and_wrong(tmp_path: Path):
    """Its four sides are equal: all photos may agree on one of them."""
    pytest.importorskip("embreex")
    pytest.importorskip("skimage")
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    import made_captures

    taken = made_captures.photograph("tower", tmp_path / "tower")
    verdict = prepare(tmp_path / "tower", tmp_path / "data")
    photos = read_colmap(tmp_path / "data", tmp_path / "data" / "sparse" / "0")
    found = [(one.name, one.rotation, one.centre) for one in [*photos.train, *photos.test]]
    true = [(name, view.rotation, view.centre) for name, view in taken.items()]
    good = {one.name for one in verdict.of(GOOD)}
    different = differences(poses(true), poses(found))
    wrong = {name for name, one in different.items() if one.turn > 1.0}
    assert not wrong & good
    assert not wrong or verdict.sure.startswith("not sure")


def test_the_true_poses_are_written(tmp_path: Path):
    pytest.importorskip("embreex")
    pytest.importorskip("skimage")
    import made_captures

    from clgs.data.transforms import read_transforms

    taken = made_captures.photograph("room", tmp_path, stops=3, width=64)
    photos = read_transforms(tmp_path)
    for photo in [*photos.train, *photos.test]:
        view = taken[Path(photo.name).name]
        # Rounding of float64, and no more.
        assert np.abs(photo.rotation - view.rotation).max() <= 1e-12
        assert np.abs(photo.centre - view.centre).max() <= 1e-12
