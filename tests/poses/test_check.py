"""The second reconstruction: its half of the tracks, and that it may be made at any time."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.opencl.device import Device
from clgs.poses.finished import Finished
from clgs.poses.judging.agreement import differences, poses_of
from clgs.poses.judging.evidence import Evidence, MatchedPair
from clgs.poses.pycolmap_lazy import quiet_pycolmap
from clgs.poses.stages import check, matching
from clgs.poses.stages.features import extract
from clgs.poses.stages.mapping import map_photos
from clgs.poses.stages.pairs import pairs_to_match
from clgs.poses.workspace import Workspace
from tests.data.folders import write_room_photos

PHOTOS, FEATURES = 4, 5
MOST_TURN = 0.5
"""Degrees."""


def evidence_of(pairs: dict[tuple[int, int], list[tuple[int, int]]]) -> Evidence:
    """PHOTOS photos of FEATURES features each, numbered from 1, with these matches."""
    matched = [
        MatchedPair(first, second, np.array(matches, np.uint32).reshape(-1, 2))
        for (first, second), matches in pairs.items()
    ]
    return Evidence(matched, {number + 1: np.zeros((FEATURES, 2)) for number in range(PHOTOS)})


def test_a_track_is_what_matches_join():
    tracks = check.tracks_of(
        evidence_of({(1, 2): [(0, 1), (1, 0)], (2, 4): [(1, 3)], (1, 4): [(0, 3)]})
    )
    assert tracks[1][0] == tracks[2][1] == tracks[4][3]
    assert tracks[1][1] == tracks[2][0]
    assert len(np.unique(np.concatenate(list(tracks.values())))) == PHOTOS * FEATURES - 3


def test_the_best_matched_pair_decides_between_two_features_of_a_photo():
    # The first feature of photo 1 cannot be both features of photo 3.
    tracks = check.tracks_of(
        evidence_of({(1, 2): [(0, 0)], (2, 3): [(0, 0)], (1, 3): [(0, 1), (1, 2)]})
    )
    assert tracks[1][0] == tracks[3][1]
    assert tracks[1][0] == tracks[2][0]
    assert tracks[3][0] != tracks[2][0]


features = st.integers(0, FEATURES - 1)
matches = st.lists(st.tuples(features, features), max_size=4)
numbers = st.tuples(st.integers(1, PHOTOS), st.integers(1, PHOTOS)).filter(lambda p: p[0] < p[1])


@settings(deadline=None)
@given(st.dictionaries(numbers, matches))
def test_no_track_has_two_features_of_a_photo(pairs):
    evidence = evidence_of(pairs)
    tracks = check.tracks_of(evidence)
    photos = defaultdict[int, set[int]](set)
    for number, track in tracks.items():
        assert len(np.unique(track)) == FEATURES
        for one in track:
            photos[int(one)].add(number)
    for pair in evidence.pairs:
        left = tracks[pair.first][pair.matches[:, 0]]
        right = tracks[pair.second][pair.matches[:, 1]]
        for one, other in zip(left.tolist(), right.tolist(), strict=True):
            assert one == other or photos[one] & photos[other]  # else they would be joined


@pytest.mark.slow
def test_begun_early_or_late_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    monkeypatch.setattr(check, "THREADS", 2)
    photos, progress = 8, list[tuple[str, int, int]]()
    write_room_photos(tmp_path / "images", photos)
    with quiet_pycolmap("a test") as pycolmap:
        workspace = Workspace(
            pycolmap,
            Device(),
            tmp_path / "images",
            tmp_path,
            [f"{number}.png" for number in range(photos)],
            [0] * photos,
            0,
            lambda *step: progress.append(step),
        )
        pycolmap.set_random_seed(0)
        extract(workspace, 320, quick=False)
        matching.match(workspace, pairs_to_match(workspace))
        evidence = matching.read_evidence(workspace)
        choice = map_photos(workspace, evidence, quick=False)
        kept = Finished(tmp_path)
        with check.Check() as late:
            expected = late.model(workspace, choice)
        progress.clear()
        with check.Check() as early:
            early.begin_early(workspace, replace(evidence, pairs=evidence.pairs[1:]))
            early.begin_early(replace(workspace, finished=kept), evidence)
            assert not progress
            found = early.model(workspace, choice)
            assert early.model(workspace, choice) is found
        assert {stage for stage, _, _ in progress} == {check.STAGE}
        with check.Check() as again:  # the piece is there: the second time it is only read
            again.begin_early(workspace, evidence)
            again.begin_early(replace(workspace, finished=kept), evidence)
            read = again.model(workspace, choice)
    first, second, third = poses_of(expected), poses_of(found), poses_of(read)
    assert len(first.names) == photos
    for one in (second, third):
        assert np.array_equal(first.rotation, one.rotation)
        assert np.array_equal(first.centre, one.centre)
    model = choice.kept.reconstruction
    assert expected.num_points3D() < model.num_points3D()
    apart = differences(poses_of(model), first)
    assert 0 < max(one.turn for one in apart.values()) < MOST_TURN
