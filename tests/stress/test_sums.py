"""Losses, rates and the optimiser: families N30, N31, N34 and N35.

N32 and N33 are in tests/ops/test_quantize.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from clgs.opencl import grid
from clgs.ops import adam, loss, rate
from clgs.reference import adam as adam_reference
from clgs.reference import loss as loss_reference
from clgs.reference import rate as rate_reference
from tests.compare import assert_close, relative_l2

SCALES, DISTANCES = (
    (1e-4, 0.3, 3.0, 1000.0),
    (0.0, 1.0, 10.0, 100.0),
)
FAR = [(b, ratio) for b in SCALES for ratio in DISTANCES if ratio == 0 or ratio * b > 0.5]


def noisy(rng, level, amplitude, shape):
    """8-bit levels around ``level`` of 0..1."""
    values = np.rint(255 * level) + rng.integers(-amplitude, amplitude + 1, (3, *shape))
    return np.clip(values, 0, 255).astype(np.uint8)


@pytest.mark.family("N30")
@pytest.mark.parametrize("amplitude", [0, 1])
@pytest.mark.parametrize("step", [0.0, 0.25 / 255, 0.5])
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_flat_pictures(device, level, step, amplitude):
    """``step``: how far the render is from the photo, evenly and by noise."""
    rng = np.random.default_rng(1)
    target = noisy(rng, level, amplitude, (40, 33))
    image = target / 255 + step * rng.normal(1, 0.3, target.shape)
    image = image.astype(np.float32)
    arrays = device.upload(image), device.upload(target)
    result = loss.forward(device, *arrays)
    wide = image.astype(np.float64)
    expected = loss_reference.forward(wide, target)
    value = result.value(device)
    assert_close(value.ssim, expected.ssim, 1e-6, "SSIM")
    assert_close(value.l1, expected.l1, 1e-7, "L1")
    d_image = device.download(loss.backward(device, *arrays, result))
    assert np.isfinite(d_image).all()
    wanted = loss_reference.backward(wide, target)
    # the derivative of SSIM is of the size of 1 / sqrt(C2) = 33 where variances vanish
    assert_close(d_image, wanted, 33 * 2e-6 / image.size, "d_image")


@pytest.mark.family("N31")
@pytest.mark.parametrize("form", ["channel", "pooled"])
@pytest.mark.parametrize(("b", "distance"), FAR)
def test_symbols_far_from_their_mean(device, b, distance, form):
    """Symbols of scale b with one at ``distance`` b."""
    x = np.rint(np.random.default_rng(3).laplace(0.3, b, (3000, 2))).astype(np.float32)
    x[17, 0] += np.rint(distance * b)
    uploaded, d_x = device.upload(x), device.zeros(x.shape)
    result = rate.forward(device, uploaded, 1.0, form)
    rate.backward(device, [(rate.slopes(device, result, 1.0), uploaded, d_x)])
    symbols = rate_reference.symbols(x, 1.0)
    bits, gradient = (f(symbols, form) for f in (rate_reference.forward, rate_reference.backward))
    assert_close(result.bits, bits, 1e-6 * bits + 1e-15, "bits")
    found = device.download(d_x)
    assert np.isfinite(found).all()
    assert_close(found, gradient, 5e-6 * np.abs(gradient).max(), "d_x")


@pytest.mark.family("N31")
@pytest.mark.parametrize("value", [0.0, 1e5, 0.49])
@pytest.mark.parametrize("rows", [1, 700])
def test_equal_symbols_are_free(device, rows, value):
    uploaded, d_x = device.upload(np.full((rows, 3), value, np.float32)), device.zeros((rows, 3))
    result = rate.forward(device, uploaded, 1.0)
    rate.backward(device, [(rate.slopes(device, result, 1.0), uploaded, d_x)])
    assert result.bits == 0
    assert not device.download(d_x).any()


@pytest.mark.family("N34")
@pytest.mark.parametrize("exponent", [-30, -20, -15, -8, 0, 10])
def test_gradients_of_any_size(device, exponent):
    """Twenty steps against Adam in float64."""
    rng = np.random.default_rng(exponent + 30)
    start = rng.normal(size=33).astype(np.float32)
    parameter, stop = device.upload(start), adam.stop_flag(device)
    moments = adam.zero_moments(device, parameter)
    wide, moments64 = start.astype(np.float64), (np.zeros(33), np.zeros(33))
    for count in range(1, 21):
        g = (rng.normal(size=33) * 10.0**exponent).astype(np.float32)
        gradient = device.upload(g)
        trained = adam.Trained(parameter, gradient, moments)
        adam.step(device, [adam.Update(trained, adam.factors(1e-3, count))], stop)
        wide, moments64 = adam_reference.step(wide, g.astype(np.float64), moments64, 1e-3, count)
    found = device.download(parameter)
    assert np.isfinite(found).all()
    if exponent >= -15:  # smaller squares are below float32's range
        # 20 roundings of the parameter and of its steps
        assert_close(found, wide, 20 * 2.0**-24 * (np.abs(wide).max() + 1), "parameter")


def bits_of(device, x, monkeypatch, group):
    monkeypatch.setattr(grid, "ANY_GROUP", group)
    result = rate.forward(device, device.upload(x), 1.0)
    return result.bits, result.table


@pytest.mark.slow
@pytest.mark.family("N35")
@pytest.mark.parametrize("rows", [999, 100_000, pytest.param(10**6, marks=pytest.mark.release)])
def test_rate_of_many_symbols(device, rows, monkeypatch):
    x = np.random.default_rng(0).laplace(100.0, 4.0, (rows, 3)).astype(np.float32)
    symbols = rate_reference.symbols(x, 1.0)
    bits, table = bits_of(device, x, monkeypatch, 64)
    expected = rate_reference.forward(symbols, "channel")
    assert_close(bits, expected, 1e-7 * expected, "bits")
    for group in (32, 128):
        other, other_table = bits_of(device, x, monkeypatch, group)
        assert other == bits
        assert np.array_equal(other_table, table)


@pytest.mark.family("N35")
@pytest.mark.parametrize("side", [33, 200, pytest.param(1826, marks=pytest.mark.release)])
def test_loss_of_many_pixels(device, side):
    """1826: 1e7 terms."""
    rng = np.random.default_rng(2)
    target = rng.integers(0, 256, (3, side, side)).astype(np.uint8)
    image = np.float32(0.2) + 0.6 * rng.random((3, side, side), np.float32)
    arrays = device.upload(image), device.upload(target)
    value = loss.forward(device, *arrays).value(device)
    expected = loss_reference.forward(image.astype(np.float64), target)
    assert_close(value.l1, expected.l1, 1e-7 * expected.l1, "L1")
    assert_close(value.ssim, expected.ssim, 1e-7, "SSIM")
    assert loss.forward(device, *arrays).value(device) == value


@pytest.mark.family("N35")
@pytest.mark.parametrize("count", [1000, 300_000, pytest.param(10**7, marks=pytest.mark.release)])
def test_volume_of_many_gaussians(device, count):
    scale = np.exp(np.random.default_rng(4).normal(-3, 1, (count, 3))).astype(np.float32)
    d_scale = device.zeros((count, 3))
    loss.volume(device, device.upload(scale), 0.01, d_scale)
    gradient = loss_reference.volume(scale.astype(np.float64), 0.01)[1]
    assert relative_l2(device.download(d_scale), gradient) <= 2e-7
