"""What the measurement of verdicts on poses does to photos, it does to the known poses, too."""

from __future__ import annotations

import numpy as np
from PIL import Image

from scripts.bench.pose_subsets import QUARTER, changed, copy_photos, known_poses
from tests.small_scene import write_scene

WIDTH, HEIGHT = 8, 4


def test_a_photo_and_its_camera_are_turned_alike():
    pixels = np.zeros((HEIGHT, WIDTH), np.uint8)
    pixels[1, 6] = 255
    turned = np.asarray(changed(Image.fromarray(pixels), "turn", 1))
    (row,), (column,) = np.nonzero(turned)
    ray = np.array([6.5 - WIDTH / 2, 1.5 - HEIGHT / 2, 1.0])  # from the middle of the photo
    x, y, _ = QUARTER @ ray
    assert (column + 0.5, row + 0.5) == (x + HEIGHT / 2, y + WIDTH / 2)


def test_poses_are_those_of_the_photos_that_were_copied(tmp_path):
    data = write_scene(tmp_path / "data", train=6, test=2)
    (tmp_path / "chosen").mkdir()
    turned = copy_photos(data / "train", 2, "turn", tmp_path / "chosen")
    assert sorted(turned) == sorted(path.name for path in (tmp_path / "chosen").iterdir())
    assert list(turned.values()) == [False, True, False]
    poses = known_poses(data, "train", turned)
    plain = known_poses(data, "train", dict.fromkeys(turned, False))
    assert poses.names == plain.names == sorted(turned)
    for name, rotation, before in zip(poses.names, poses.rotation, plain.rotation, strict=True):
        np.testing.assert_array_equal(rotation, (QUARTER if turned[name] else np.eye(3)) @ before)
