"""The second reconstruction: its half of the tracks, and that it may be made at any time."""

import os
import shutil
import threading
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from clgs.poses import pycolmap_child, reconstruct
from clgs.poses.evidence import Evidence, MappedModel, MatchedPair, differences, explain, poses_of
from clgs.poses.known import Known
from clgs.poses.stages import check, mapping, matching
from clgs.poses.stages.global_mapper import GLOBAL
from clgs.poses.stages.mapping import MANY, map_by, map_photos, replace_doubtful
from clgs.poses.stages.pairs import pairs_to_match
from clgs.poses.unfinished import Finished
from tests.poses.stages.room import room_workspace

PHOTOS, FEATURES = 4, 5
ROOM_PHOTOS = 8
MOST_TURN, BENT = 0.5, 3.0
"""Degrees."""

HANG = 120
"""Seconds after which no mapper is waited for."""


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


@pytest.mark.parametrize(
    ("available", "photos"), [(1 << 30, (1 << 30) // check.PHOTO_MEMORY), (None, MANY)]
)
def test_two_mappers_run_at_once_if_memory_is_free(monkeypatch, available, photos):
    monkeypatch.setattr(check, "available_memory", lambda: available)
    assert check.fit_together(photos)
    assert not check.fit_together(photos + 1)


@pytest.fixture(scope="module")
def reconstructed(tmp_path_factory):
    """A workspace of ROOM_PHOTOS photos with matches, and the model that they give."""
    pytest.importorskip("pycolmap", reason="pycolmap has no wheel for this platform")
    with room_workspace(tmp_path_factory.mktemp("room"), ROOM_PHOTOS) as workspace:
        matching.match(workspace, pairs_to_match(workspace))
        choice = map_photos(workspace, matching.read_evidence(workspace), quick=False)
        yield workspace, choice


@pytest.mark.slow
def test_global_mappers_at_once_do_not_disturb_each_other(reconstructed, monkeypatch):
    plain, choice = reconstructed
    monkeypatch.setattr(check, "THREADS", 2)
    monkeypatch.setattr(check, "mappers", lambda _: [GLOBAL])
    found = list[tuple[NDArray[np.float64], NDArray[np.float64]]]()
    for at_once in (False, True):
        with check.SecondReconstruction() as tested, TemporaryDirectory() as folder:
            workspace = replace(plain, finished=Finished(Path(folder)))
            if at_once:
                tested.begin_early(workspace, choice.evidence)
            shutil.rmtree(plain.folder / GLOBAL, ignore_errors=True)
            (first,) = map_by(GLOBAL, workspace, "poses")
            kept = MappedModel(GLOBAL, first, explain(first, choice.evidence))
            second = tested.model(workspace, replace(choice, kept=kept))
            found.append((poses_of(first).centre, poses_of(second).centre))
    for late, early in zip(*found, strict=True):
        assert np.array_equal(late, early)


@pytest.mark.slow
def test_a_check_that_is_given_up_ends_the_global_mapper(reconstructed, monkeypatch):
    workspace, choice = reconstructed
    monkeypatch.setattr(check, "THREADS", 2)
    monkeypatch.setattr(check, "mappers", lambda _: [GLOBAL])
    with check.SecondReconstruction() as given_up:
        given_up.begin_early(workspace, choice.evidence)
    assert given_up._made.done()
    assert not pycolmap_child._running


def kill_the_global_mapper(most):
    """Kill ``most`` global mappers as soon as they run, as a system without free memory does."""
    killed, end = list[int](), time.monotonic() + HANG
    while len(killed) < most and time.monotonic() < end:
        for mapper in [one for one in list(pycolmap_child._running) if one.pid not in killed]:
            mapper.kill()
            killed.append(mapper.pid)
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows does not say that a process was killed")
def test_a_mapper_that_was_killed_next_to_the_other_is_asked_once_more(reconstructed, monkeypatch):
    plain, choice = reconstructed
    monkeypatch.setattr(check, "THREADS", 2)
    monkeypatch.setattr(check, "mappers", lambda _: [GLOBAL])
    kept = MappedModel(GLOBAL, choice.kept.reconstruction, choice.kept.explained)
    asked = replace(choice, kept=kept)
    with check.SecondReconstruction() as whole:
        expected = poses_of(whole.model(plain, asked)).centre
    with check.SecondReconstruction() as tested:
        tested.begin_early(plain, choice.evidence)
        kill_the_global_mapper(1)
        assert np.array_equal(poses_of(tested.model(plain, asked)).centre, expected)
    with check.SecondReconstruction() as tested:
        assert not tested.give_up()
        tested.begin_early(plain, choice.evidence)
        assert tested.give_up()
        assert not pycolmap_child._running
        assert np.array_equal(poses_of(tested.model(plain, asked)).centre, expected)
    killer = threading.Thread(target=kill_the_global_mapper, args=[2])
    with check.SecondReconstruction() as tested:
        tested.begin_early(plain, choice.evidence)
        killer.start()
        with pytest.raises(pycolmap_child.CrashError, match="enough memory"):
            tested.model(plain, asked)
    killer.join()


@pytest.mark.slow
def test_a_model_is_made_again_alone_if_both_were_killed(reconstructed, monkeypatch):
    workspace, _ = reconstructed
    monkeypatch.setattr(reconstruct, "match", lambda *_: False)  # the matches are there
    monkeypatch.setattr(check, "THREADS", 2)
    for module in (check, mapping):
        monkeypatch.setattr(module, "mappers", lambda _: [GLOBAL])
    expected = map_photos(workspace, matching.read_evidence(workspace), quick=False)
    killer = threading.Thread(target=kill_the_global_mapper, args=[2])
    with check.SecondReconstruction() as tested:
        killer.start()
        _, found, _ = reconstruct._match_and_map(workspace, Known(), tested, [])
        killer.join()
        assert tested.model(workspace, found) is not None
    first, second = (poses_of(one.kept.reconstruction).centre for one in (expected, found))
    assert np.array_equal(first, second)


@pytest.mark.slow
def test_begun_early_or_late_it_is_the_same(reconstructed, tmp_path, monkeypatch):
    monkeypatch.setattr(check, "THREADS", 2)
    plain, choice = reconstructed
    progress, evidence = list[tuple[str, int, int]](), choice.evidence
    workspace = replace(plain, on_progress=lambda *step: progress.append(step))
    kept = replace(workspace, finished=Finished(tmp_path))
    with check.SecondReconstruction() as late:
        expected = late.model(workspace, choice)
    progress.clear()
    with check.SecondReconstruction() as early:
        early.begin_early(workspace, replace(evidence, pairs=evidence.pairs[1:]))
        early.begin_early(kept, evidence)
        assert not progress
        found = early.model(kept, choice)
        assert early.model(kept, choice) is found
    assert {stage for stage, _, _ in progress} == {check.STAGE}
    with check.SecondReconstruction() as again:  # the piece is there: it is only read
        again.begin_early(workspace, evidence)
        again.begin_early(kept, evidence)
        read = again.model(kept, choice)
    first = poses_of(expected)
    assert len(first.names) == ROOM_PHOTOS
    for one in (poses_of(found), poses_of(read)):
        assert np.array_equal(first.rotation, one.rotation)
        assert np.array_equal(first.centre, one.centre)
    model = choice.kept.reconstruction
    assert expected.num_points3D() < model.num_points3D()
    assert 0 < most_turn(model, expected) < MOST_TURN


@pytest.mark.slow
def test_a_photo_that_was_bent_is_placed_again(reconstructed, tmp_path):
    workspace, choice = reconstructed
    model, pycolmap = choice.kept.reconstruction, workspace.pycolmap
    model.write(tmp_path)
    bent, name = pycolmap.Reconstruction(tmp_path), workspace.names[3]
    frame = bent.find_image_with_name(name).frame
    half = np.radians(BENT) / 2
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d([0, np.sin(half), 0, np.cos(half)]), np.zeros(3))
    frame.rig_from_world = turn * frame.rig_from_world
    assert most_turn(model, bent) == pytest.approx(BENT, abs=0.1)
    wrong = MappedModel(choice.kept.mapper, bent, explain(bent, choice.evidence))
    doubt = replace(choice, kept=wrong, candidates=[wrong])
    found = replace_doubtful(workspace, doubt, [name], "other poses")
    assert most_turn(model, found.kept.reconstruction) < MOST_TURN
    assert found.candidates == [found.kept]
    # What would explain fewer matches is not taken, and of many doubtful photos none is moved.
    assert replace_doubtful(workspace, doubt, workspace.names[:3], "other poses") is doubt
    again = replace_doubtful(workspace, choice, [name], "other poses")
    assert again is choice or again.kept.explained.total > choice.kept.explained.total


def most_turn(one, other) -> float:
    """The largest angle between two models' rotations of a photo, degrees."""
    apart = differences(poses_of(one), poses_of(other))
    assert len(apart) == ROOM_PHOTOS
    return max(difference.turn for difference in apart.values())
