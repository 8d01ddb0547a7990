"""Pairs are matched in several processes, and none of what they find depends on how many."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.errors import DataError
from clgs.poses import matching
from clgs.poses.features import extract
from clgs.poses.job import Job
from clgs.poses.pycolmap_lazy import quiet_pycolmap
from tests.data.folders import room_image, room_poses

pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")

PHOTOS = 5


@pytest.fixture
def job(tmp_path: Path):
    """Features of some photos of a room."""
    images = tmp_path / "images"
    images.mkdir()
    names = [f"{number}.png" for number in range(PHOTOS)]
    for name, pose in zip(names, room_poses(2 * PHOTOS), strict=False):
        Image.fromarray(room_image(pose, (200, 150), 200.0)).save(images / name)
    told: list[tuple[str, int, int]] = []
    with quiet_pycolmap("a test") as pycolmap:
        job = Job(pycolmap, images, tmp_path, names, [0] * PHOTOS, 0, lambda *one: told.append(one))
        extract(job, 200, quick=True)
        told.clear()
        yield job, told


def found(job: Job):
    """(matches, inliers) of each pair, and forgets them."""
    with job.open() as database:
        numbers, matches = database.read_all_matches()
        verified = dict(zip(*database.read_two_view_geometries(), strict=True))
        database.clear_matches()
        database.clear_two_view_geometries()
    return {
        number: (np.array(one), np.array(verified[number].inlier_matches))
        for number, one in zip(numbers, matches, strict=True)
    }


def test_any_number_of_processes_finds_the_same(job, monkeypatch):
    job, told = job
    results = []
    for processes in (1, 3):
        monkeypatch.setattr(matching, "THREADS", processes)
        assert matching.match(job) == PHOTOS * (PHOTOS - 1) // 2
        results.append(found(job))
        assert not list(job.folder.glob("matching_*"))
    one, three = results
    assert len(one) == len(three) == PHOTOS * (PHOTOS - 1) // 2
    assert sum(len(matches) for matches, _ in one.values()) > 500
    for number, arrays in one.items():
        assert all(map(np.array_equal, arrays, three[number]))
    assert told[:3] == [("matches", done, 10) for done in (0, 10, 0)]
    assert told[3:] == sorted(told[3:])  # whoever is first
    assert told[-1] == ("matches", 10, 10)


def test_a_failure_of_one_process_is_told(job, monkeypatch):
    job, _ = job
    monkeypatch.setattr(matching, "THREADS", 2)
    job = replace(job, seed="no number")
    with pytest.raises(DataError, match="matching: "):
        matching.match(job)
