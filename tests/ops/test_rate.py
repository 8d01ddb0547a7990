"""The rate proxy's kernels and host arithmetic against the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import rate
from clgs.reference import rate as reference
from tests.compare import assert_close, relative_l2

FORMS = ["channel", "pooled"]
CASES = {
    "feature": ((4100, 50), 3.0, 0.0, 1.0),
    "offset": ((515, 10, 3), 0.4, 0.0, 1.0),
    "scaling": ((999, 6), 1.0, -5.0, 8.0),
    "far mean": ((3000, 4), 2.0, 3000.0, 1.0),
    "wide": ((300, 5), 2000.0, 100.0, 1.0),
    "beyond the floor": ((300, 5), 60000.0, 100.0, 1.0),
    "few rows": ((7, 3), 2.0, 0.0, 1.0),
    "one channel": ((9000, 1), 1.0, 0.25, 1.0),
}


def run(device, x, q, form, weight=1.0):
    array = device.upload(x)
    result = rate.forward(device, array, q, form)
    d_x = device.zeros(x.shape)
    rate.backward(device, [(rate.slopes(device, result, weight), array, d_x)])
    return result.bits, device.download(d_x)


def expected_of(x, q, form):
    symbols = reference.symbols(x, q).reshape(len(x), -1)
    gradient = reference.backward(symbols, form).reshape(x.shape) * q
    return reference.forward(symbols, form), gradient


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("case", CASES)
def test_agrees_with_reference(device, rng, case, form):
    shape, spread, mean, q = CASES[case]
    x = (rng.laplace(0, spread, shape) + mean).astype(np.float32)
    bits, d_x = run(device, x, q, form)
    expected, gradient = expected_of(x, q, form)
    # integer sums are exact below 2^24 a block; beyond, 256 roundings of a block's sum of squares
    assert_close(bits, expected, 1e-7 * expected + 1e-12, "bits")
    if np.linalg.norm(gradient) > 0:
        assert relative_l2(d_x, gradient) <= 1e-6
    # slope * k + offset: three roundings of terms of the largest gradient's size, and those of b
    assert_close(d_x, gradient, 32 * 2.0**-24 * np.abs(gradient).max() + 1e-30, "d_x")


def test_outlier_in_the_far_tail(device):
    x = np.zeros((20000, 2), np.float32)
    x[7, 0], x[9, 1] = 1.0, -250.0  # about 200 b from the mean
    bits, d_x = run(device, x, 1.0, "channel")
    expected, gradient = expected_of(x, 1.0, "channel")
    assert_close(bits, expected, 1e-6 * expected, "bits")
    assert_close(d_x[[7, 9], [0, 1]], gradient[[7, 9], [0, 1]], 5e-6 * np.abs(gradient).max(), "d")
    assert relative_l2(d_x, gradient) <= 5e-6
    assert d_x[7, 0] > 0 > d_x[9, 1], "a far symbol is pulled back"


def test_means_at_a_half_are_continuous(device):
    x = np.array([[0.0], [1.0]] * 50, np.float32)
    bits, d_x = run(device, x, 1.0, "channel")
    expected, gradient = expected_of(x, 1.0, "channel")
    assert_close(bits, expected, 1e-12, "bits")
    assert_close(d_x, gradient, 4 * 2.0**-24 * np.abs(gradient).max(), "d_x")


def test_cost_of_laplace_data_is_its_entropy(device, rng):
    # with std as b it would be 0.08 bit more
    for spread in (0.5, 2.0, 10.0):
        x = np.rint(rng.laplace(0, spread, (200_000, 1))).astype(np.float32)
        counts = np.unique(x, return_counts=True)[1] / x.size
        entropy = -np.sum(counts * np.log2(counts))
        assert_close(run(device, x, 1.0, "channel")[0], entropy, 0.005, f"b = {spread}")


def test_backward_adds_and_weighs(device, rng):
    x = rng.normal(0, 2, (100, 6)).astype(np.float32)
    array, start = device.upload(x), rng.normal(size=x.shape).astype(np.float32)
    result, d_x = rate.forward(device, array, 8.0), device.upload(start)
    rate.backward(device, [(rate.slopes(device, result, 0.5), array, d_x)])
    gradient = expected_of(x, 8.0, "channel")[1] * 0.5
    assert_close(device.download(d_x), start + gradient, 4 * 2.0**-24 * np.abs(start).max(), "d_x")


def test_same_bits_on_both_specialisations(open_device, rng):
    x = rng.laplace(0, 3, (5000, 7)).astype(np.float32)
    for form in FORMS:
        cpu, gpu = (run(open_device(name), x, 1.0, form) for name in ("cpu", "gpu"))
        assert cpu[0] == gpu[0]
        assert np.array_equal(cpu[1], gpu[1])


@pytest.mark.parametrize("form", FORMS)
def test_nothing_costs_nothing(device, form):
    bits, d_x = run(device, np.zeros((0, 6), np.float32), 1.0, form)
    assert bits == 0.0
    assert d_x.shape == (0, 6)


@pytest.mark.parametrize("form", FORMS)
def test_poison_reaches_the_bits(device, form):
    x = np.ones((50, 4), np.float32)
    x[3, 1] = np.nan
    assert not np.isfinite(run(device, x, 1.0, form)[0])


def test_wrong_arguments_are_refused(device):
    x = device.zeros((4, 6))
    with pytest.raises(ValueError, match="pooled"):
        rate.forward(device, x, 1.0, "tiled")
    with pytest.raises(TypeError, match="float32"):
        rate.forward(device, device.zeros((4, 6), np.int32), 1.0)
    slopes = rate.slopes(device, rate.forward(device, x, 1.0), 1.0)
    with pytest.raises(ValueError, match="d_x"):
        rate.backward(device, [(slopes, x, device.zeros((3, 6)))])
