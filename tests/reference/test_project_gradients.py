"""The analytic gradients of the projection reference against central differences."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import BLUR, NEAR_PLANE
from clgs.reference import project as reference
from tests.compare import assert_close, central_difference
from tests.ops.cases.project import camera_at, gaussians, widen


@pytest.mark.family("N09")
@pytest.mark.parametrize("spread", [1.0, 2.5], ids=["inside", "a third at the clamp"])
@pytest.mark.parametrize("which", ["mean", "scale", "rotation"])
def test_gradient(rng, which, spread):
    count = 20
    values = widen(gaussians(rng, count))
    values["mean"][:, :2] *= spread
    values["scale"] *= 8  # far off-axis ones must still reach the frame
    values["opacity"][:] = 0.9
    packed = camera_at().pack(NEAR_PLANE).astype(np.float64)
    projected = reference.forward(**values, camera=packed)
    weight2d = rng.normal(size=(count, 2))
    weight_whitening = rng.normal(size=(count, 3))
    if spread > 1:
        point = values["mean"] @ packed[:9].reshape(3, 3).T + packed[9:12]
        slope, limits = point[:, :2] / point[:, 2:], packed[19:23].reshape(2, 2)
        assert np.any((slope < limits[:, 0]) | (slope > limits[:, 1]))

    def objective(x):
        moved = reference.forward(**{**values, which: x}, camera=packed)
        same = (moved.extent[:, :1] > 0) & (projected.extent[:, :1] > 0)
        parts = weight2d * moved.mean2d + 0 * same
        return float(np.sum(parts) + np.sum(weight_whitening * moved.whitening))

    analytic = reference.backward(
        (values["mean"], values["scale"], values["rotation"]),
        packed,
        projected,
        weight2d,
        weight_whitening,
    )[("mean", "scale", "rotation").index(which)]
    numeric = central_difference(objective, values[which]).reshape(analytic.shape)
    assert_close(analytic, numeric, 1e-6 * np.abs(numeric).max(), which)


@pytest.mark.parametrize("which", ["mean", "scale", "rotation"])
def test_gradient_of_the_opacity_of_antialiased_ones(rng, which):
    values = widen(gaussians(rng, 20))
    values["opacity"][:] = 0.9
    packed = camera_at().pack(NEAR_PLANE).astype(np.float64)
    antialiased = (*(0.0,) * 7, BLUR)
    weight = rng.normal(size=20)
    projected = reference.forward(**values, camera=packed, screen=antialiased)
    weight[projected.extent[:, 0] == 0] = 0

    def shown(moved):
        shape = moved["mean"], moved["scale"], moved["rotation"]
        return reference.shown_opacity(shape, values["opacity"], packed, antialiased)

    analytic = reference.backward(
        (values["mean"], values["scale"], values["rotation"]),
        packed,
        projected,
        np.zeros((20, 2)),
        np.zeros((20, 3)),
        weight * shown(values),
    )[("mean", "scale", "rotation").index(which)]

    def objective(x):
        return float(np.sum(weight * shown({**values, which: x})))

    numeric = central_difference(objective, values[which]).reshape(analytic.shape)
    assert_close(analytic, numeric, 1e-6 * np.abs(numeric).max(), which)
