"""Ordinary Gaussians as a camera sees them, against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.constants import NEAR_PLANE
from clgs.ops.general import splats
from clgs.reference.general import splats as reference
from clgs.reference.neural import Gaussians
from clgs.scene.gaussians import OrdinaryGaussians
from tests.compare import assert_close, relative_l2
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import gradients, on_device, stored, widen

EPSILON = 2.0**-24
SEEN = ("mean", "scale", "rotation", "color", "opacity")
PACKED = camera_at().pack(NEAR_PLANE)


def run_forward(device, gaussians):
    uploaded, camera = gaussians.map(device.upload), device.upload(PACKED)
    return uploaded, camera, splats.forward(device, uploaded, camera)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 15, 333])
def test_forward_agrees_with_reference(device, rng, degree, count):
    gaussians = stored(rng, count, degree)
    found = run_forward(device, gaussians)[2]
    wanted = reference.forward(widen(gaussians), PACKED)
    # 16 products below 1.5, their functions with up to eight roundings each
    terms = 0.5 + 8 * np.abs(gaussians.sh).sum(axis=1)
    bounds = {
        "mean": 0.0,
        "scale": 8 * EPSILON * np.abs(wanted.scale),
        "rotation": 8 * EPSILON,
        "color": 8 * EPSILON * terms,
        "opacity": 8 * EPSILON,
    }
    for name in SEEN:
        mine = device.download(getattr(found, name))
        assert_close(mine, getattr(wanted, name), bounds[name], name)
    assert degree < 3 or (wanted.color == 0).any() or count < 100


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_backward_agrees_with_reference(device, rng, degree):
    gaussians, d_seen = stored(rng, 700, degree), gradients(rng, 700)
    gaussians.log_scale[5] = 25.0  # beyond the clamp: no gradient
    uploaded, camera, seen = run_forward(device, gaussians)
    found = splats.backward(device, uploaded, camera, seen, on_device(device, d_seen))
    wide = Gaussians(**{name: array.astype(np.float64) for name, array in d_seen.items()})
    wanted = reference.backward(widen(gaussians), PACKED, wide)
    # a color near 0 may be clamped in one and not in the other
    sure = np.abs(device.download(seen.color) - 0).min(axis=1) > 1e-4
    sure |= reference.forward(widen(gaussians), PACKED).color.min(axis=1) == 0
    for name, array in found.items():
        mine, theirs = device.download(array), getattr(wanted, name)
        assert relative_l2(mine[sure], theirs[sure]) <= 1e-5, name
    assert not device.download(found.log_scale)[5].any()


def test_a_coefficient_of_minus_one_is_56_in_8_bits(device):
    """What every 3DGS viewer should show: 255 (1/2 - 0.2821) = 55.6."""
    one = stored(np.random.default_rng(0), 1, 0)
    one.sh[:] = -1.0
    color = device.download(run_forward(device, one)[2].color)
    assert np.rint(255 * color).tolist() == [[56, 56, 56]]


@pytest.mark.parametrize("which", ["mean", "log_scale", "rotation", "opacity", "sh"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_poison_stays_in_its_row(device, rng, which, poison):
    clean = stored(rng, 65)
    dirty = OrdinaryGaussians(*(array.copy() for _, array in clean.items()))
    getattr(dirty, which)[30] = poison
    others = np.arange(65) != 30
    one, other = (run_forward(device, some)[2] for some in (clean, dirty))
    for name in SEEN:
        pair = (device.download(getattr(some, name))[others] for some in (one, other))
        assert np.array_equal(*pair), name


def test_a_gaussian_in_the_camera_has_a_color(device, rng):
    gaussians = stored(rng, 1)
    gaussians.mean[0] = camera_at().centre
    color = device.download(run_forward(device, gaussians)[2].color)
    assert np.isfinite(color).all()


def test_wrong_arrays_are_refused(device, rng):
    uploaded = stored(rng, 5).map(device.upload)
    camera = device.upload(PACKED)
    with pytest.raises(ValueError, match="camera"):
        splats.forward(device, uploaded, uploaded.mean)
    with pytest.raises(ValueError, match="sh"):
        replace(uploaded, sh=device.zeros((5, 5, 3)))
    with pytest.raises(TypeError, match="opacity"):
        splats.forward(device, replace(uploaded, opacity=device.zeros((5,), np.int32)), camera)


def test_no_gaussians(device, rng):
    empty = stored(rng, 1).map(lambda array: array[:0])
    assert run_forward(device, empty)[2].color.shape == (0, 3)
