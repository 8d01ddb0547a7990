"""A photo with a wrong pose is found by a short training; right ones are not suspected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.data.view import View
from clgs.train.run.pose_check import LEAST_VARIANCE, unexplained, unexplained_share
from tests.small_scene import write_scene


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return load_dataset(write_scene(tmp_path_factory.mktemp("poses") / "data", train=14, test=2))


def turned(view: View, degrees: float) -> View:
    """The view with its camera turned in place, about its down-vector."""
    angle = np.radians(degrees)
    turn = np.eye(3)
    turn[::2, ::2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    rotation = turn @ view.camera.rotation
    camera = replace(view.camera, rotation=rotation, translation=-rotation @ view.camera.centre)
    return replace(view, camera=camera)


def test_turned_photo_is_what_training_cannot_show(dataset, cpu):
    train = [*dataset.train[:5], turned(dataset.train[5], 15.0), *dataset.train[6:]]
    steps = []
    found = unexplained(
        replace(dataset, train=train), cpu, lambda done, total: steps.append((done, total))
    )
    wrong = found.pop(train[5].name)
    assert len(found) == 15
    assert wrong > 0.5
    assert max(found.values()) < 0.5 * wrong
    assert steps[-1] == (len(steps), len(steps))


def test_share_is_of_the_variance():
    photo = np.zeros((4, 6, 3), np.uint8)
    photo[:, 3:] = 200
    assert unexplained_share(photo, photo) == 0.0
    assert unexplained_share(np.full_like(photo, 100), photo) == pytest.approx(1.0)
    assert unexplained_share(255 - photo, photo) == pytest.approx(1.0)


def test_brightness_and_contrast_are_forgiven(rng):
    photo = rng.integers(0, 128, (12, 16, 3)).astype(np.uint8)
    assert unexplained_share(40 + photo, photo) == pytest.approx(0.0, abs=1e-12)
    assert unexplained_share(2 * photo, photo) == pytest.approx(0.0, abs=1e-12)
    other = rng.integers(0, 128, (12, 16, 3)).astype(np.uint8)
    assert unexplained_share(other, photo) > 0.8


def test_masked_pixels_do_not_count():
    photo = np.zeros((4, 6, 3), np.uint8)
    photo[:, 3:] = 200
    render = photo.copy()
    render[0] = 77
    used = np.ones((4, 6), np.uint8)
    used[0] = 0
    assert unexplained_share(render, photo) > 0
    assert unexplained_share(render, photo, used) == 0.0


def test_photo_of_one_colour_divides_by_no_zero():
    photo = np.full((4, 6, 3), 9, np.uint8)
    assert unexplained_share(photo + np.uint8(1), photo) == 0.0
    photo[0, 0] += 1
    assert unexplained_share(np.zeros_like(photo), photo) < 1 / 255**2 / LEAST_VARIANCE
