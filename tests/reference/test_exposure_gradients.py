"""The reference of the exposure stage against central differences."""

from __future__ import annotations

import numpy as np

from clgs.reference import exposure
from tests.compare import assert_close, central_difference

WEIGHT = 0.3


def test_gradients_are_differences(rng):
    image, d_picture = rng.normal(size=(2, 3, 4, 5))
    one = np.eye(3, 4) + rng.normal(0, 0.3, (3, 4))

    def value(image, one):
        picture = exposure.forward(image, one)
        return float(np.sum(picture * d_picture)) + exposure.penalty(one, WEIGHT)

    d_image, d_one = exposure.backward(image, d_picture, one, WEIGHT)
    slopes = central_difference(lambda x: value(x, one), image, step=1e-5)
    assert_close(d_image.ravel(), slopes, 1e-6 * np.abs(d_image).max(), "d_image")
    slopes = central_difference(lambda x: value(image, x), one, step=1e-5)
    assert_close(d_one.ravel(), slopes, 1e-6 * np.abs(d_one).max(), "d_exposure")
