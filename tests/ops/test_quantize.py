"""Rounding on the device equals NumPy's, value by value."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.opencl import programs
from clgs.opencl.device import Device
from clgs.ops import quantize
from clgs.reference import quantize as reference

SCALES = [1.0, 200.0, 1024.0]


def rounded(device, x, q):
    array = device.upload(x)
    return (
        device.download(quantize.forward(device, [(array, q)])[0]),
        device.download(quantize.integers(device, array, q)),
    )


@pytest.mark.family("N32")
@pytest.mark.parametrize("first", [-(2**22), -70000, 0, 2**22 - 100_000])
def test_halves_and_their_neighbours(device, first):
    halves = np.arange(first, first + 100_001, dtype=np.float64).astype(np.float32) + np.float32(
        0.5
    )
    for x in (halves, np.nextafter(halves, np.inf), np.nextafter(halves, -np.inf)):
        x = x.astype(np.float32)
        values, integers = rounded(device, x, 1.0)
        assert np.array_equal(values, np.rint(x))
        assert np.array_equal(integers, np.rint(x).astype(np.int32))


@pytest.mark.release
@pytest.mark.family("N32")
def test_all_halves(device):
    for first in range(-(2**22), 2**22, 2**20):
        halves = np.arange(first, first + 2**20, dtype=np.int64) + np.float64(0.5)
        x = halves.astype(np.float32)
        assert np.array_equal(rounded(device, x, 1.0)[1], np.rint(x).astype(np.int32))


@pytest.mark.parametrize("q", SCALES)
def test_agrees_with_reference(device, rng, q):
    x = (rng.normal(0, 1, 100_003) * np.exp(rng.uniform(-8, 8, 100_003))).astype(np.float32)
    x = np.concatenate(
        [x, np.float32([0.49999997, -0.49999997, (2**23 + 1) / q, 0.0, -0.0, 1e-38])]
    )
    values, integers = rounded(device, x, q)
    assert np.array_equal(values, reference.forward(x, q))
    assert np.array_equal(np.signbit(values), np.signbit(reference.forward(x, q)))
    assert np.array_equal(integers, reference.integers(x, q))


def test_a_scale_for_each_element(device, rng):
    x = rng.normal(0, 1, 13_711).astype(np.float32)
    q = (2.0 ** rng.integers(-3, 14, len(x))).astype(np.float32)
    x[:4], q[:4] = [-0.0, -0.4, 0.5, -1.5], 1.0
    rounded = device.download(quantize.elements(device, device.upload(x), device.upload(q)))
    expected = reference.elements(x, q)
    assert np.array_equal(rounded.view(np.uint32), expected.view(np.uint32))
    assert not np.signbit(rounded[rounded == 0]).any()
    assert np.array_equal(rounded * q, np.rint(x * q))
    odd = rng.uniform(1, 999, len(x)).astype(np.float32)
    rounded = device.download(quantize.elements(device, device.upload(x), device.upload(odd)))
    assert np.array_equal(rounded, reference.elements(x, odd))


@pytest.mark.slow
@pytest.mark.parametrize("towards", ["INFINITY", "-INFINITY"])
def test_a_device_whose_division_is_inexact_rounds_like_others(device, rng, monkeypatch, towards):
    def read(name, read_program=programs.read_program):
        exact, inexact = "n / q;", f"nextafter(n / q, (fv)({towards}));"
        text = read_program(name)
        assert exact in text
        return text.replace(exact, inexact)

    monkeypatch.setattr(programs, "read_program", read)
    inexact = Device(specialisation=device.specialisation)
    for q in (3.0, *SCALES):
        x = (rng.choice([-1, 1], 10_003) * np.exp(rng.uniform(0, 8, 10_003))).astype(np.float32)
        values = inexact.download(quantize.forward(inexact, [(inexact.upload(x), q)])[0])
        assert np.array_equal(values, reference.forward(x, q))
        scale = np.full(x.shape, q, np.float32)
        array = quantize.elements(inexact, inexact.upload(x), inexact.upload(scale))
        assert np.array_equal(inexact.download(array), reference.elements(x, scale))


@pytest.mark.family("N33")
@pytest.mark.parametrize("q", SCALES)
def test_integers_survive_the_round_trip(device, q):
    n = np.arange(-(2**20), 2**20 + 1, dtype=np.int32)
    values = (n.astype(np.float32) / np.float32(q)).astype(np.float32)
    again, integers = rounded(device, values, q)
    assert np.array_equal(integers, n)
    assert np.array_equal(again, values)


def test_values_beyond_integers(device):
    x = np.float32([np.nan, np.inf, -np.inf, 3e38, 1e10, -1e10] * 5)
    values, integers = rounded(device, x, 8.0)
    with np.errstate(over="ignore"):
        assert np.array_equal(values, reference.forward(x, 8.0), equal_nan=True)
    assert integers[0] == 0
    assert integers[1] == integers[4] == 2**31 - 1
    assert integers[2] == integers[5] == -(2**31)


@pytest.mark.parametrize("shape", [(0,), (15, 1), (2, 3, 4)])
def test_shapes(device, rng, shape):
    x = rng.normal(0, 5, shape).astype(np.float32)
    values, integers = rounded(device, x, 1.0)
    assert np.array_equal(values, np.rint(x))
    assert np.array_equal(integers, np.rint(x).astype(np.int32))


def test_gradient_passes_straight_through(rng):
    d_rounded = rng.normal(size=(5, 6))
    assert reference.backward(d_rounded) is d_rounded


def test_wrong_dtype_is_refused(device):
    with pytest.raises(TypeError, match="int32"):
        quantize.forward(device, [(device.zeros((3,), np.int32), 1.0)])
    with pytest.raises(TypeError, match="int32"):
        quantize.elements(device, device.zeros((3,), np.int32), device.zeros((3,)))
    for q in (device.zeros((4,)), device.zeros((3,), np.int32)):
        with pytest.raises(ValueError, match="q: "):
            quantize.elements(device, device.zeros((3,)), q)
