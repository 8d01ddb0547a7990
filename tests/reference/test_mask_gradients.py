"""The reference of the mask stage, with the loss behind it, against central differences."""

from __future__ import annotations

import numpy as np

from clgs.reference import loss, mask
from tests.compare import assert_close, central_difference


def test_gradient_is_a_difference(rng):
    image = rng.uniform(0.1, 0.9, (3, 6, 7))
    used = (rng.uniform(size=(6, 7)) < 0.6).astype(np.uint8)
    photo = rng.integers(0, 256, image.shape).astype(np.uint8) * used

    def value(image):
        return loss.forward(mask.forward(image, used), photo).value

    found = mask.backward(loss.backward(mask.forward(image, used), photo), used)
    slopes = central_difference(value, image, step=1e-6)
    assert_close(found.ravel(), slopes, 1e-6 * np.abs(found).max(), "d_image")
