"""The float64 loss against central differences."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.reference import loss
from tests.compare import assert_close, central_difference


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "weights"),
    [((1, 1), (0.8, 0.2)), ((5, 14), (1.0, 0.0)), ((5, 14), (0.8, 0.2)), ((13, 12), (0.0, 1.0))],
)
def test_image_gradient(rng, size, weights):
    target = rng.integers(0, 256, (3, *size)).astype(np.uint8)
    offset = rng.choice([-1, 1], target.shape) * rng.uniform(0.01, 0.3, target.shape)
    image = loss.to_levels(target) + offset  # no kink of |x| within a step
    gradient = loss.backward(image, target, *weights)
    slopes = central_difference(lambda x: loss.forward(x, target, *weights).value, image)
    assert_close(gradient.ravel(), slopes, 1e-6 * np.abs(gradient).max(), "d_image")


def test_l1_gradient_is_zero_where_images_agree(rng):
    target = rng.integers(0, 256, (3, 4, 5)).astype(np.uint8)
    assert np.array_equal(
        loss.backward(loss.to_levels(target), target, 1.0, 0.0), np.zeros((3, 4, 5))
    )


def test_volume_gradient(rng):
    scale = rng.uniform(0.1, 2, (7, 3))
    gradient = loss.volume(scale, 0.3)[1]
    slopes = central_difference(lambda s: 0.3 * loss.volume(s, 0.3)[0], scale)
    assert_close(gradient.ravel(), slopes, 1e-6 * np.abs(gradient).max(), "d_scale")
