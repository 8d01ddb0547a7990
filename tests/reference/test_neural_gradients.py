"""The neural Gaussians' analytic gradients against central differences, the drawn set frozen."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import LOG_SCALE_LIMIT
from clgs.reference import neural
from tests.compare import assert_close, central_difference
from tests.ops.cases.neural import case, gradients, widen

NAMES = ("output", "offset", "scaling")


@pytest.fixture
def problem(rng):
    values = widen(case(rng, 5, 8))
    opacity = values["output"][:10]
    opacity[np.abs(opacity) < 1e-3] = 0.5  # the test for a positive opacity stays as it is
    values["scaling"][values["visible"][0], 1] = -LOG_SCALE_LIMIT - 1
    values["scaling"][values["visible"][1], 4] = LOG_SCALE_LIMIT + 1
    values["output"][0, 1] = -1  # keeps the scale of e^20 from burying the others
    values["output"][40:43, 2] = -40, 0, 40
    return values, widen(gradients(rng, int((opacity > 0).sum())))


def loss(values, d_gaussians):
    result = neural.forward(**values)
    names = ("mean", "scale", "rotation", "color", "opacity")
    return float(sum(np.sum(getattr(result, n) * d_gaussians[f"d_{n}"]) for n in names))


def analytic(values, d_gaussians):
    without_position = {n: v for n, v in values.items() if n != "position"}
    given = neural.GaussianGradients(**d_gaussians)
    result = neural.backward(neural.forward(**values), **without_position, d_gaussians=given)
    return dict(zip(NAMES, result, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_gradient(problem, name):
    values, d_gaussians = problem
    found = analytic(values, d_gaussians)[name]
    numeric = central_difference(
        lambda moved: loss({**values, name: moved}, d_gaussians), values[name]
    ).reshape(values[name].shape)
    assert np.abs(found).max() > 0
    # scales of e^20 and e^-20 side by side: each anchor is held to its own largest gradient
    axis = (0,) if name == "output" else tuple(range(1, values[name].ndim))
    largest = np.abs(found).max(axis=axis, keepdims=True)
    shared = abs(loss(values, d_gaussians)) * 1e-9
    assert_close(found, numeric, 1e-6 * largest + shared, name)


def test_clamped_scales_have_no_gradient(problem):
    values, d_gaussians = problem
    found = analytic(values, d_gaussians)["scaling"]
    assert found[values["visible"][0], 1] == 0
    assert found[values["visible"][1], 4] == 0


def test_split_and_join_are_inverse(rng):
    output = rng.normal(size=(110, 7))
    opacity, color, logits, quaternion = neural.split(output)
    joined = neural.join(opacity, color, np.concatenate([logits, quaternion], 1))
    assert np.array_equal(joined, output)
