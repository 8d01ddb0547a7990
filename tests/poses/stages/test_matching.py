"""Photos are matched alike on every device, and verified alike by any number of processes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clgs.errors import DataError
from clgs.opencl.device import Device
from clgs.ops import match as nearest_descriptors
from clgs.poses.pycolmap_child import quiet_pycolmap
from clgs.poses.stages import matching, verify
from clgs.poses.stages.features import extract
from clgs.poses.stages.pairs import pairs_to_match
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
        workspace = Workspace(pycolmap, Device(), images, tmp_path, names, cameras, 0, ignore)
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


@pytest.mark.slow
def test_any_device_and_number_of_processes_finds_the_same(workspace, monkeypatch):
    results, progress = [], []
    pairs = pairs_to_match(workspace)
    for form, processes in (("cpu", 1), ("cpu", 3), ("gpu", 3)):
        monkeypatch.setattr(verify, "THREADS", processes)
        device = Device(specialisation=form)
        matching.match(
            replace(workspace, device=device, on_progress=lambda *one: progress.append(one)), pairs
        )
        results.append(found(workspace))
        assert not list(workspace.folder.glob("verifying_*"))
    assert len(results[0]) == len(pairs) == PAIRS
    assert sum(len(matches) for matches, _ in results[0].values()) > 500
    for other in results[1:]:
        assert other.keys() == results[0].keys()
        for number, arrays in results[0].items():
            assert all(map(np.array_equal, arrays, other[number]))
    own = len(progress) // 3
    assert progress[0] == ("looks", 0, PAIRS)
    assert progress[1:3] == [("looks", PAIRS, PAIRS), ("matches", 0, PAIRS)]
    assert ("matches", PAIRS, PAIRS) in progress[:own]
    assert progress[-1] == ("geometry", PAIRS, PAIRS)


@pytest.mark.slow
def test_a_failure_of_one_process_is_an_error(workspace, monkeypatch):
    monkeypatch.setattr(verify, "THREADS", 2)
    with pytest.raises(DataError, match="two-view geometry: "):
        matching.match(replace(workspace, seed="no number"), pairs_to_match(workspace))


def test_matches_are_those_of_all_products(device, rng):
    """The ratio test and the cross check, from the angles between all descriptors."""
    photos = []
    for count in (300, 260):
        x = np.abs(rng.standard_normal((count, 128))) ** 1.5
        photos.append(512 * x / np.linalg.norm(x, axis=1, keepdims=True))
    photos[1][:120] = photos[0][40:160] + rng.normal(0, 12, (120, 128))
    first, second = (np.clip(np.rint(photo), 0, 255).astype(np.uint8) for photo in photos)
    angle = np.arccos(np.minimum(first.astype(float) @ second.astype(float).T / 2**18, 1.0))

    def chosen(angle):
        near = np.sort(angle, axis=1)[:, :2]
        good = (near[:, 0] <= 0.7) & (near[:, 0] < 0.8 * near[:, 1])
        return {(i, angle[i].argmin()) for i in np.flatnonzero(good)}

    wanted = chosen(angle) & {(i, j) for j, i in chosen(angle.T)}
    assert len(wanted) > 50
    uploaded = nearest_descriptors.upload(device, [first, second])
    (found,) = matching.mutual_matches(device, uploaded, [first, second], [(0, 1)], 0.8)
    assert {tuple(one) for one in found.tolist()} == wanted


def test_a_cheap_look_finds_the_pairs_that_share_something(workspace):
    blank = Image.fromarray(np.full((150, 200, 3), 99, np.uint8))
    blank.save(workspace.images / "blank.png")
    noise = np.random.default_rng(1).integers(0, 255, (15, 20, 3), np.uint8)
    Image.fromarray(noise).resize((200, 150)).save(workspace.images / "other.png")
    workspace.database.unlink()
    names = [*workspace.names, "blank.png", "other.png"]
    workspace = replace(workspace, names=names, cameras=[0] * len(names))
    extract(workspace, 200, quick=True)
    every = [(i, j) for j in range(len(names)) for i in range(j)]
    alike = matching.pairs_alike(workspace, every)
    assert alike == [pair for pair in every if max(pair) < PHOTOS]


@pytest.mark.slow
def test_all_features_are_used_where_the_largest_give_few_matches(workspace, monkeypatch):
    pairs = pairs_to_match(workspace)
    assert not matching.match(workspace, pairs)  # no photo has as many features
    whole = found(workspace)
    monkeypatch.setattr(matching, "ENOUGH_MATCHES", 0)
    assert not matching.match(workspace, pairs, 100)  # so few photos are matched in full
    few = found(workspace)
    monkeypatch.setattr(matching, "MAX_FULL", 0)
    monkeypatch.setattr(matching, "ENOUGH_MATCHES", 10**6)
    assert not matching.match(workspace, pairs, 100)
    thin = found(workspace)
    monkeypatch.setattr(matching, "ENOUGH_MATCHES", 0)
    assert matching.match(workspace, pairs, 100)
    with workspace.open() as database:
        ids = workspace.ids(database)
        keypoints = {number: database.read_keypoints(number) for number in ids}
        numbers, short = database.read_all_matches()
    assert 0 < sum(map(len, short)) < sum(len(matches) for matches, _ in whole.values())
    for number, matches in zip(numbers, short, strict=True):
        for column, photo in enumerate(workspace.pycolmap.pair_id_to_image_pair(number)):
            scale = matching.turn_and_scale(np.asarray(keypoints[photo], np.float64))[:, 1]
            assert scale[np.asarray(matches)[:, column]].min() >= np.sort(scale)[-100]
    matching.match_in_full(workspace, pairs)
    for again in (few, thin, found(workspace)):
        assert again.keys() == whole.keys()
        for number, arrays in whole.items():
            assert all(map(np.array_equal, arrays, again[number]))
