"""Captures far from the origin of their coordinates: family N24."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.data.dataset import load_dataset
from clgs.synthetic.gaussians import gaussian_scene
from tests.data.folders import opengl, ring, save_json, write_transforms
from tests.stress.cases import LEVEL, draw

SHIFTS = [0.0, 1e3, 1e4, 1e5, 1e6, 1e7]


def loaded(folder, shift):
    """The data set of a ring of cameras around ``shift``."""
    document = write_transforms(folder)
    for frame, pose in zip(document["frames"], ring(10), strict=True):
        moved = pose.copy()
        moved[:3, 3] += shift
        frame["transform_matrix"] = opengl(moved)
    save_json(folder, document)
    return load_dataset(folder, load_images=False)


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    return {
        (shift, axis): loaded(tmp_path_factory.mktemp("far"), shift * np.eye(3)[axis])
        for shift in SHIFTS
        for axis in range(3)
    }


@pytest.mark.family("N24")
@pytest.mark.parametrize("view", [0, 3])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("shift", SHIFTS)
def test_shifted_captures_give_the_same_picture(device, datasets, shift, axis, view):
    """World coordinates in float64 are recentred before they become float32."""
    scene = gaussian_scene(np.random.default_rng(axis), 500, 1.0, 0.1)
    images = []
    for moved in (0.0, shift):
        dataset = datasets[moved, axis]
        world = scene.mean.astype(np.float64) + moved * np.eye(3)[axis]
        placed = replace(
            scene,
            mean=dataset.transform.to_scene(world).astype(np.float32),
            scale=(scene.scale * dataset.transform.scale).astype(np.float32),
        )
        images.append(draw(device, placed, dataset.train[view].camera).image)
    error = np.abs(images[0] - images[1]) / LEVEL
    # doubles of 1e7 hold 2e-9, 1e-7 pixels here; a pair at the alpha cut may flip
    assert np.mean(error > 2e-3) <= 1e-3
    assert error.max() <= 1.05
    assert np.ptp(images[0]) > 0.3
