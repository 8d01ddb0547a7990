"""The MLPs' analytic gradients against central differences, away from the kinks of the ReLU."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.reference import mlp
from tests.compare import assert_close, central_difference
from tests.ops.cases.mlp import anchors, packed_camera

NAMES = ("weights", "feature")


@pytest.fixture
def case(rng):
    values = anchors(rng, 9)
    values = {name: value.astype(np.float64) for name, value in values.items()}
    visible = np.array([1, 4, 5, 8], np.int32)
    d_output = rng.normal(size=(110, 4))
    return values, visible, d_output


def loss(values, visible, d_output):
    result = mlp.forward(**values, visible=visible, camera=packed_camera())
    return float(np.sum(result.output * d_output))


def gradients(values, visible, d_output):
    activations = mlp.forward(**values, visible=visible, camera=packed_camera())
    arguments = (len(values["position"]), values["weights"], d_output)
    return dict(zip(NAMES, mlp.backward(activations, *arguments), strict=True))


def chosen(rng, name, array):
    """Every coordinate, but of the weights a sample that meets all twelve arrays."""
    if name != "weights":
        return list(np.ndindex(array.shape))
    ends = [0, 2650, 2700, 3200, 3210, 7379, 7410, 10139, 13709]
    return [(int(i),) for i in [*ends, *rng.integers(0, 13710, 300)]]


@pytest.mark.parametrize("name", NAMES)
def test_gradient(case, rng, name):
    values, visible, d_output = case
    hidden = [
        head.hidden_weight @ x[:-1] + head.hidden_bias[:, None]
        for head in mlp.heads(values["weights"])
        for x in [mlp.forward(**values, visible=visible, camera=packed_camera()).input]
    ]
    assert np.abs(hidden).min() > 1e-4, "a kink is within reach of the step"
    analytic = gradients(values, visible, d_output)[name]
    indices = chosen(rng, name, values[name])
    numeric = central_difference(
        lambda moved: loss({**values, name: moved}, visible, d_output), values[name], 1e-6, indices
    )
    found = np.array([analytic[i] for i in indices])
    assert_close(found, numeric, 1e-6 * np.abs(analytic).max(), name)
    assert np.abs(analytic).max() > 0


def test_invisible_anchors_have_no_gradient(case):
    values, visible, d_output = case
    others = np.setdiff1d(np.arange(9), visible)
    result = gradients(values, visible, d_output)
    assert not result["feature"][others].any()


def test_camera_centre_has_no_direction(case):
    values, visible, _ = case
    values["position"][visible[0]] = packed_camera()[mlp.CENTRE]
    activations = mlp.forward(**values, visible=visible, camera=packed_camera())
    assert not activations.input[50:53, 0].any()
