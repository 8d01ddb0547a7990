"""The fused Adam kernel against NumPy's float32 update and the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import adam
from clgs.reference import adam as reference
from clgs.train.step.numpy_adam import HostTensors, update
from tests.compare import assert_close


def gradients(rng, steps, size):
    """Sizes from 1e-30 to 1e10, some zeros, and rows that stop getting any."""
    for number in range(steps):
        g = rng.normal(size=size) * 10.0 ** rng.uniform(-30, 10, size)
        g[rng.random(size) < 0.1] = 0
        g[: size // 4] *= number < steps // 2
        yield g.astype(np.float32)


@pytest.mark.parametrize("views", [1, 4])
def test_equals_numpy_to_the_bit(device, rng, views):
    betas = adam.BETAS.of_batch(views)
    parameter = rng.normal(size=1003).astype(np.float32)
    on_device, stop = device.upload(parameter), adam.stop_flag(device)
    moments = adam.zero_moments(device, on_device)
    state = HostTensors(parameter, *np.zeros((2, 1003), np.float32))
    for count, g in enumerate(gradients(rng, 60, 1003), start=1):
        rate = 0.01 * 0.99**count
        now = adam.factors(rate, count, betas)
        update(state, g, now)
        adam.step(
            device, [adam.Update(adam.Trained(on_device, device.upload(g), moments), now)], stop
        )
    assert np.array_equal(device.download(on_device), parameter)
    assert np.array_equal(device.download(moments.first), state.first)
    assert np.array_equal(device.download(moments.second), state.second)
    assert np.isfinite(parameter).all()


@pytest.mark.family("N34")
@pytest.mark.parametrize("views", [1, 4])
def test_follows_float64(device, rng, views):
    betas = 0.9**views, 0.999**views
    start = rng.normal(size=500)
    wide, moments64 = start.copy(), (np.zeros(500), np.zeros(500))
    on_device, stop = device.upload(start.astype(np.float32)), adam.stop_flag(device)
    moments = adam.zero_moments(device, on_device)
    size = 10.0 ** rng.uniform(-12, 5, 500)
    for count in range(1, 301):
        g = (rng.normal(size=500) * size).astype(np.float32)
        wide, moments64 = reference.step(
            wide, g.astype(np.float64), moments64, 1e-3, count, betas=betas
        )
        now = adam.factors(1e-3, count, adam.Betas(*betas))
        adam.step(
            device, [adam.Update(adam.Trained(on_device, device.upload(g), moments), now)], stop
        )
    # 300 roundings of the parameter itself, random in sign, and of steps of 1e-3
    assert_close(device.download(on_device), wide, 1e-5 * np.maximum(np.abs(wide), 1), "parameter")
    second = device.download(moments.second)
    assert_close(second, moments64[1], 1e-4 * moments64[1], "second moment")


def test_tiny_gradients_still_move(device):
    # a second moment flushed at 1e-30 would make this step ten times too long
    on_device, stop = device.zeros((1,)), adam.stop_flag(device)
    moments = adam.zero_moments(device, on_device)
    gradient = device.upload(np.float32([1e-14]))
    trained = adam.Trained(on_device, gradient, moments)
    adam.step(device, [adam.Update(trained, adam.factors(0.1, 1))], stop)
    expected = reference.step(np.zeros(1), np.array([1e-14]), (np.zeros(1), np.zeros(1)), 0.1, 1)[0]
    assert_close(device.download(on_device), expected, 1e-6, "parameter")


def test_moments_decay_to_zero_not_to_subnormals(device):
    on_device, stop = device.zeros((40,)), adam.stop_flag(device)
    moments = adam.Moments(*(device.upload(np.full(40, x, np.float32)) for x in (1e-29, 1e-35)))
    trained = adam.Trained(on_device, device.zeros((40,)), moments)
    for count in range(1, 40):
        adam.step(device, [adam.Update(trained, adam.factors(0.1, count))], stop)
    assert not device.download(moments.first).any()
    second = device.download(moments.second)
    assert ((second == 0) | (second >= adam.MIN_SECOND_MOMENT)).all()


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 1001])
def test_bad_gradients_change_nothing(device, rng, poison, place):
    parameter = rng.normal(size=1002).astype(np.float32)
    g = rng.normal(size=1002).astype(np.float32)
    on_device, stop = device.upload(parameter), adam.stop_flag(device)
    moments = adam.zero_moments(device, on_device)
    fine = device.upload(g)
    adam.check_finite(device, [fine, device.zeros((0, 3))], stop)
    assert device.download(stop)[0] == 0
    g[place] = poison
    bad = device.upload(g)
    adam.check_finite(device, [bad, fine], stop)
    assert device.download(stop)[0] == adam.NOT_FINITE
    adam.check_finite(device, [fine], stop)
    assert device.download(stop)[0] == adam.NOT_FINITE, "it stays set"
    now = adam.factors(0.1, 1)
    adam.step(device, [adam.Update(adam.Trained(on_device, bad, moments), now)], stop)
    marks = adam.mark_rows(device, fine, device.zeros((1,), np.int32))
    adam.step_rows(device, adam.Trained(on_device, fine, moments), now, stop, marks)
    assert np.array_equal(device.download(on_device), parameter)
    assert not device.download(moments.first).any()


@pytest.mark.parametrize("value", [1, -5])
def test_any_value_of_the_flag_stops(device, value):
    on_device, stop = device.zeros((40, 3)), device.upload(np.array([value], np.int32))
    moments, ones = (
        adam.zero_moments(device, on_device),
        device.upload(np.ones((40, 3), np.float32)),
    )
    adam.check_finite(device, [ones], stop)
    marks = adam.mark_rows(device, ones, stop)
    trained = adam.Trained(on_device, ones, moments)
    adam.step(device, [adam.Update(trained, adam.factors(0.1, 1))], stop)
    adam.step_rows(device, trained, adam.factors(0.1, 1), stop, marks)
    assert device.download(stop).tolist() == [value]
    assert not device.download(on_device).any()


def sparse_gradients(rng, rows, width):
    """Gradients (rows, width) of which some rows are zero, and one that is not all but nearly."""
    g = rng.normal(size=(rows, width)).astype(np.float32)
    g[rng.random(rows) < 0.5] = 0
    g[rows // 2] = 0
    g[rows // 2, -1] = -1e-42  # a subnormal, not zero
    return g


@pytest.mark.parametrize(("rows", "width"), [(0, 6), (1, 50), (7, 1), (333, 6), (333, 30)])
def test_by_rows_only_those_with_a_gradient_move(device, rng, rows, width):
    parameter = rng.normal(size=(rows, width)).astype(np.float32)
    on_device, stop = device.upload(parameter), adam.stop_flag(device)
    moments = adam.zero_moments(device, on_device)
    state = HostTensors(parameter, *np.zeros((2, rows, width), np.float32))
    wide, moments64 = parameter.astype(np.float64), (np.zeros((rows, width)),) * 2
    for count in range(1, 9):
        g = sparse_gradients(rng, rows, width) if rows else parameter
        gradient = device.upload(g)
        marks = adam.mark_rows(device, gradient, stop)
        moved = (g != 0).any(axis=1)
        assert np.array_equal(device.download(marks), moved)
        now = adam.factors(0.01, count)
        trained = adam.Trained(on_device, gradient, moments)
        adam.step_rows(device, trained, now, stop, marks)
        part = HostTensors._make(array[moved] for array in state)
        update(part, g[moved], now)
        for array, changed in zip(state, part, strict=True):
            array[moved] = changed
        wide, moments64 = reference.step(
            wide, g.astype(np.float64), moments64, 0.01, count, moved[:, None]
        )
    assert np.array_equal(device.download(on_device), parameter)
    assert np.array_equal(device.download(moments.first), state.first)
    assert np.array_equal(device.download(moments.second), state.second)
    normal = np.abs(moments64[0]) > 1e-30  # steps by subnormals depend on how they are flushed
    assert_close(parameter[normal], wide[normal], 1e-6, "parameter")


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_marking_finds_bad_gradients(device, rng, poison):
    stop, g = adam.stop_flag(device), np.zeros((100, 30), np.float32)
    adam.mark_rows(device, device.upload(g), stop)
    assert device.download(stop)[0] == 0
    g[99, 29] = poison
    marks = adam.mark_rows(device, device.upload(g), stop)
    assert device.download(stop)[0] == adam.NOT_FINITE
    assert np.flatnonzero(device.download(marks)).tolist() == [99]


def test_bias_correction_is_exact():
    now = adam.factors(0.5, 1)
    assert_close(now.correction, 1000**0.5, 1e-11, "correction")  # 1 - 0.999 in double
    assert_close(now.step, 5.0, 1e-14, "step")


def test_wrong_sizes_are_refused(device):
    parameter, stop = device.zeros((3, 4)), adam.stop_flag(device)
    moments = adam.zero_moments(device, parameter)
    wrong = adam.Trained(parameter, device.zeros((3, 5)), moments)
    with pytest.raises(ValueError, match="gradient"):
        adam.step(device, [adam.Update(wrong, adam.factors(1.0, 1))], stop)
    marks, trained = device.zeros((4,), np.int32), adam.Trained(parameter, parameter, moments)
    with pytest.raises(ValueError, match="marks"):
        adam.step_rows(device, trained, adam.factors(1.0, 1), stop, marks)


def test_many_parts_as_one_after_the_other(device, rng):
    # more parts than a launch takes, some of them empty, one tensor in three
    sizes = [1003, 0, 5, 64, 4096, 1, 1030]
    values = [rng.normal(size=size).astype(np.float32) for size in sizes]
    gradients = [device.upload(rng.normal(size=size).astype(np.float32)) for size in sizes]
    together, apart = ([device.upload(one) for one in values] for _ in range(2))
    now = [adam.factors(0.01 * (i + 1), i + 1) for i in range(9)]
    stop, parts = adam.stop_flag(device), [slice(0, 100), slice(100, 100), slice(131, 1003)]
    for tensors in (together, apart):
        moments = [adam.zero_moments(device, one) for one in tensors]
        trained = [adam.Trained(*each) for each in zip(tensors, gradients, moments, strict=True)]
        chosen = [(trained[0], part) for part in parts] + [(one, None) for one in trained[1:]]
        updates = [
            adam.Update(one, factors, part)
            for (one, part), factors in zip(chosen, now, strict=True)
        ]
        for some in [updates] if tensors is together else [[one] for one in updates]:
            adam.step(device, some, stop)
    for mine, theirs, before in zip(together, apart, values, strict=True):
        assert np.array_equal(device.download(mine), device.download(theirs))
        assert not before.size or not np.array_equal(device.download(mine), before)
    assert np.array_equal(device.download(together[0])[100:131], values[0][100:131])


@pytest.mark.parametrize("bad", range(7))
def test_each_of_many_arrays_is_checked(device, bad):
    arrays = [np.zeros(size, np.float32) for size in (256, 255, 20_000, 0, 257, 1, 3)]
    if arrays[bad].size:
        arrays[bad][-1] = np.nan
    stop = adam.stop_flag(device)
    adam.check_finite(device, [device.upload(one) for one in arrays], stop)
    assert device.download(stop)[0] == (adam.NOT_FINITE if arrays[bad].size else 0)


def test_updates_of_a_step_share_their_betas(device):
    zero, stop = device.zeros((3,)), adam.stop_flag(device)
    trained = adam.Trained(zero, zero, adam.zero_moments(device, zero))
    now = [adam.factors(0.1, 1, adam.BETAS.of_batch(views)) for views in (1, 2)]
    with pytest.raises(ValueError, match="betas"):
        adam.step(device, [adam.Update(trained, one) for one in now], stop)


@pytest.mark.parametrize("size", [1, 37, 1003])
def test_a_mean_is_that_of_float64(device, rng, size):
    given = [rng.normal(5, 1, size).astype(np.float32) for _ in range(400)]
    mean, stop = device.zeros((size,)), adam.stop_flag(device)
    adam.average(device, mean, device.upload(given[0]), 1, stop)
    assert np.array_equal(device.download(mean), given[0])
    for count, parameter in enumerate(given[1:], start=2):
        adam.average(device, mean, device.upload(parameter), count, stop)
    assert_close(device.download(mean), reference.average(given), 1e-5, "mean")


def test_a_mean_that_is_stopped_or_does_not_fit_stays(device):
    mean, parameter = device.zeros((40,)), device.upload(np.ones(40, np.float32))
    adam.average(device, mean, parameter, 3, device.upload(np.array([1], np.int32)))
    assert not device.download(mean).any()
    with pytest.raises(ValueError, match="mean"):
        adam.average(device, device.zeros((41,)), parameter, 1, adam.stop_flag(device))
    adam.average(device, device.zeros((0,)), device.zeros((0,)), 1, adam.stop_flag(device))
