"""The analytic backward of the float64 blend against central differences, decisions frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.reference import blend, tiles
from clgs.reference.project import Projected
from tests.compare import central_difference
from tests.gaussians import projected_scene

SIZE = 37, 20
NAMES = ("mean2d", "whitening", "color", "opacity")


@pytest.fixture
def case(rng):
    """A scene with saturated alphas, clamped colours and finished pixels; its lists and weights."""
    scene = projected_scene(rng, 60, *SIZE, sigma_median=4.0)
    values = {k: v.astype(np.float64) for k, v in vars(scene).items()}
    values["opacity"][:6] = 1.3
    values["color"][7] = 2e3, 0.5, -5e3
    values["mean2d"][8:24] = 20.2, 9.1
    values["opacity"][8:24] = 0.9
    geometry = {k: values[k] for k in ("mean2d", "whitening", "depth", "extent")}
    projected = Projected(**geometry)
    lists = tiles.forward(projected, values["opacity"], *SIZE)
    arguments = {
        "projected": projected,
        "color": values["color"],
        "opacity": values["opacity"],
        "tiles": lists,
        "background": np.array([0.3, 0.9, 0.1]),
    }
    return arguments, rng.normal(size=(3, SIZE[1], SIZE[0]))


def loss(arguments, d_image, decisions, name, x):
    if name in ("mean2d", "whitening"):
        changed = {"projected": replace(arguments["projected"], **{name: x})}
    else:
        changed = {name: x}
    result = blend.forward(**{**arguments, **changed}, size=SIZE, decisions=decisions)
    return float(np.sum(result.image * d_image))


@pytest.mark.parametrize("name", NAMES)
def test_backward_agrees_with_central_differences(case, rng, name):
    arguments, d_image = case
    made = blend.forward(**arguments, size=SIZE)
    assert made.decisions.saturated.any()
    assert (made.transmittance < 2e-4).any()
    analytic = blend.backward(**arguments, decisions=made.decisions, d_image=d_image)
    gradient = getattr(analytic, f"d_{name}")
    projected = arguments["projected"]
    x = getattr(projected, name) if hasattr(projected, name) else arguments[name]
    every = list(np.ndindex(x.shape))
    indices = [every[i] for i in rng.permutation(len(every))[:50]]
    numeric = central_difference(
        lambda changed: loss(arguments, d_image, made.decisions, name, changed),
        x,
        step=1e-5,
        indices=indices,
    )
    chosen = np.array([gradient[i] for i in indices])
    assert np.linalg.norm(chosen) > 0
    assert np.linalg.norm(numeric - chosen) <= 1e-6 * np.linalg.norm(chosen)


def test_frozen_own_decisions_change_nothing(case):
    arguments, _ = case
    made = blend.forward(**arguments, size=SIZE)
    again = blend.forward(**arguments, size=SIZE, decisions=made.decisions)
    assert np.array_equal(made.image, again.image)
    assert np.array_equal(made.last_blended, again.last_blended)


def test_gradient_vanishes_where_clamped(case):
    arguments, d_image = case
    made = blend.forward(**arguments, size=SIZE)
    gradient = blend.backward(**arguments, decisions=made.decisions, d_image=d_image)
    assert gradient.d_color[7, 0] == gradient.d_color[7, 2] == 0.0
    assert gradient.d_color[7, 1] != 0.0


def test_one_pixel_by_hand():
    projected = Projected(
        mean2d=np.full((2, 2), 0.5),
        whitening=np.array([[1.0, 0, 1]] * 2),
        depth=np.array([2.0, 1.0]),
        extent=np.ones((2, 2)),
    )
    opacity, color = np.array([0.5, 0.25]), np.array([[1.0, 0, 0], [0, 1.0, 0]])
    lists = tiles.forward(projected, opacity, 1, 1)
    assert lists.gaussian.tolist() == [1, 0]
    result = blend.forward(projected, color, opacity, lists, np.array([0, 0, 1.0]), (1, 1))
    assert np.allclose(result.image[:, 0, 0], [0.75 * 0.5, 0.25, 0.75 * 0.5], atol=1e-15, rtol=0)
    assert result.last_blended.tolist() == [[2]]
