"""Pairs are matched in several processes, and none of what they find depends on how many."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.errors import DataError
from clgs.poses import matching
from clgs.poses.matching import extract
from clgs.poses.pairs import pairs_to_match
from clgs.poses.pycolmap_lazy import quiet_pycolmap
from clgs.poses.workspace import Workspace
from tests.data.folders import room_image, room_poses

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

PHOTOS = 5
PAIRS = PHOTOS * (PHOTOS - 1) // 2


@pytest.fixture
def workspace(tmp_path: Path):
    """Features of some photos of a room."""
    images = tmp_path / "images"
    images.mkdir()
    names = [f"{number}.png" for number in range(PHOTOS)]
    for name, pose in zip(names, room_poses(2 * PHOTOS), strict=False):
        Image.fromarray(room_image(pose, (200, 150), 200.0)).save(images / name)
    with quiet_pycolmap("a test") as pycolmap:
        cameras, ignore = [0] * PHOTOS, lambda *_: None
        workspace = Workspace(pycolmap, images, tmp_path, names, cameras, 0, ignore)
        extract(workspace, 200, quick=True)
        yield workspace


def found(workspace: Workspace):
    """Take (matches, inliers) of each pair out of the database."""
    with workspace.open() as database:
        numbers, matches = database.read_all_matches()
        verified = dict(zip(*database.read_two_view_geometries(), strict=True))
        database.clear_matches()
        database.clear_two_view_geometries()
    return {
        number: (np.array(one), np.array(verified[number].inlier_matches))
        for number, one in zip(numbers, matches, strict=True)
    }


def test_any_number_of_processes_finds_the_same(workspace, monkeypatch):
    results, progress = [], []
    workspace = replace(workspace, on_progress=lambda *one: progress.append(one))
    pairs = pairs_to_match(workspace)
    for processes in (1, 3):
        monkeypatch.setattr(matching, "THREADS", processes)
        matching.match(workspace, pairs)
        results.append(found(workspace))
        assert not list(workspace.folder.glob("matching_*"))
    one, three = results
    assert len(one) == len(three) == len(pairs) == PAIRS
    assert sum(len(matches) for matches, _ in one.values()) > 500
    for number, arrays in one.items():
        assert all(map(np.array_equal, arrays, three[number]))
    assert progress[:3] == [("matches", done, PAIRS) for done in (0, PAIRS, 0)]
    assert progress[3:] == sorted(progress[3:])  # the order of the processes does not matter
    assert progress[-1] == ("matches", PAIRS, PAIRS)


def test_a_failure_of_one_process_is_an_error(workspace, monkeypatch):
    monkeypatch.setattr(matching, "THREADS", 2)
    with pytest.raises(DataError, match="matching: "):
        matching.match(replace(workspace, seed="no number"), pairs_to_match(workspace))
