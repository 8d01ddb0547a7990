"""Features lie where the picture has them, as pycolmap's own search finds them."""

import sys

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from clgs.errors import DataError
from clgs.poses.stages import features

cv2 = pytest.importorskip("cv2")

MANY = 8192


@pytest.fixture(scope="module")
def picture():
    """Noise of several scales, (240, 320) uint8."""
    rng = np.random.default_rng(0)
    layers = [gaussian_filter(rng.normal(size=(240, 320)), 2**k) * 2**k for k in range(4)]
    noise = sum(layers)
    return np.uint8(np.clip(128 + 40 * noise / noise.std(), 0, 255))


def nearest(found, expected):
    """Distances of points (N, 2) to the nearest of others (M, 2), and differences (N, 2)."""
    distance, index = cKDTree(expected).query(found)
    return distance, found - expected[index]


def test_a_picture_that_is_turned_has_its_features_where_they_were(picture):
    keypoints, _ = features.find_sift(cv2, picture, None, MANY)
    turned, _ = features.find_sift(cv2, np.rot90(picture).copy(), None, MANY)
    # a quarter to the left: (x, y) is at (y, width - x) in pixels whose first centre is 0.5
    back = np.stack([picture.shape[1] - turned[:, 1], turned[:, 0]], axis=1)
    distance, difference = nearest(back, keypoints[:, :2])
    near = distance < 0.5
    assert len(keypoints) > 300
    assert near.mean() > 0.9
    assert np.abs(difference[near].mean(axis=0)).max() < 0.02


def test_shape_turns_and_grows_with_the_picture(picture):
    keypoints, _ = features.find_sift(cv2, picture, None, MANY)
    large = np.asarray(Image.fromarray(picture).resize((640, 480), Image.Resampling.BICUBIC))
    turned, _ = features.find_sift(cv2, np.rot90(large).copy(), None, MANY)
    back = np.stack([picture.shape[1] - turned[:, 1] / 2, turned[:, 0] / 2], axis=1)
    distance, index = cKDTree(keypoints[:, :2]).query(back)
    near = distance < 0.2
    shape = keypoints[index[near], 2:].reshape(-1, 2, 2)
    quarter = np.array([[0, 1], [-1, 0]])
    ratio = turned[near, 2:].reshape(-1, 2, 2) @ np.linalg.inv(shape)
    assert near.sum() > 100
    assert np.median(np.abs(ratio - 2 * quarter).max(axis=(1, 2))) < 0.1


def test_features_are_those_of_pycolmap(picture, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    Image.fromarray(picture).save(tmp_path / "a.png")
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.peak_threshold = 0.004
    pycolmap.extract_features(
        tmp_path / "a.db", tmp_path, extraction_options=options, device=pycolmap.Device.cpu
    )
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        theirs = np.asarray(database.read_keypoints(1), np.float64)
        described = np.asarray(database.read_descriptors(1).data, np.float64)
    keypoints, descriptors = features.find_sift(cv2, picture, None, MANY)
    distance, difference = nearest(keypoints[:, :2], theirs[:, :2])
    assert (distance < 0.5).mean() > 0.8
    assert np.abs(difference[distance < 0.5].mean(axis=0)).max() < 0.05
    # of two features at one place, the directions of the shapes must be the same as well
    place, shape = theirs[:, :2], theirs[:, 2:] / np.linalg.norm(theirs[:, 2:], axis=1)[:, None]
    own = keypoints[:, 2:] / np.linalg.norm(keypoints[:, 2:], axis=1)[:, None]
    gap, index = cKDTree(np.hstack([place, 4 * shape])).query(
        np.hstack([keypoints[:, :2], 4 * own])
    )
    same = gap < 0.5
    product = (descriptors[same] * described[index[same]]).sum(axis=1) / features.LENGTH**2
    scale = np.linalg.norm(keypoints[same, 2:], axis=1) / np.linalg.norm(
        theirs[index[same], 2:], axis=1
    )
    assert same.mean() > 0.7
    assert np.median(product) > 0.95
    assert abs(np.median(scale) - 1) < 0.03


def test_descriptors_have_one_length(picture):
    _, descriptors = features.find_sift(cv2, picture, None, MANY)
    assert descriptors.dtype == np.uint8
    length = np.linalg.norm(descriptors.astype(float), axis=1)
    assert np.abs(length / features.LENGTH - 1).max() < 0.02


def test_the_largest_ones_are_kept(picture):
    every, described = features.find_sift(cv2, picture, None, MANY)
    some, some_described = features.find_sift(cv2, picture, None, 50)
    scales = np.linalg.norm(every[:, 2:], axis=1)
    assert len(some) == 50
    assert np.linalg.norm(some[:, 2:], axis=1).min() >= np.sort(scales)[-50] - 1e-4
    rows = [np.flatnonzero((every == one).all(axis=1))[0] for one in some]
    assert np.array_equal(described[rows], some_described)


def test_nothing_is_found_in_masked_and_in_flat_parts(picture):
    mask = np.zeros_like(picture)
    mask[:, 100:] = 255
    keypoints, _ = features.find_sift(cv2, picture, mask, MANY)
    assert keypoints[:, 0].min() >= 100
    flat, descriptors = features.find_sift(cv2, np.full_like(picture, 7), None, MANY)
    assert (flat.shape, descriptors.shape) == ((0, 6), (0, 128))


@pytest.mark.parametrize("largest", [640, features.FINEST_SIZE])
def test_a_reduced_photo_has_its_features_in_pixels_of_the_whole(picture, tmp_path, largest):
    large = Image.fromarray(picture).resize((640, 480), Image.Resampling.BICUBIC)
    large.save(tmp_path / "a.png")
    mask = np.zeros((480, 640), np.uint8)
    mask[:, 200:] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    keypoints, _ = features.find_features(
        cv2, tmp_path / "a.png", tmp_path / "mask.png", largest, MANY
    )
    plain, _ = features.find_sift(cv2, picture, None, MANY)
    _, difference = nearest(plain[plain[:, 0] > 110, :2] * 2, keypoints[:, :2])
    near = np.abs(difference).max(axis=1) < 1
    assert keypoints[:, 0].min() >= 199
    assert near.mean() > 0.8
    assert np.abs(difference[near].mean(axis=0)).max() < 0.05


def test_a_missing_opencv_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(DataError, match=r"^features: OpenCV cannot .* opencv-python-headless$"):
        features.opencv("features")
