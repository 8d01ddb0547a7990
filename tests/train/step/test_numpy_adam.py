"""The in-place NumPy Adam, alone and as the optimizer of a training run."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from clgs.errors import DataError
from clgs.ops import adam
from clgs.reference import adam as reference
from clgs.train.config import preset
from clgs.train.run.session import train_scene
from clgs.train.state.hashes import scene_hash
from clgs.train.step import numpy_adam
from clgs.train.step.numpy_adam import HostTensors, update
from tests.compare import assert_close


def zero_state(*shape, start=0.0):
    return HostTensors(np.full(shape, start, np.float32), *np.zeros((2, *shape), np.float32))


def test_follows_float64(rng):
    wide = rng.normal(size=(50, 6))
    state = zero_state(50, 6)
    state.parameter[:] = wide
    moments = (np.zeros((50, 6)), np.zeros((50, 6)))
    size = 10.0 ** rng.uniform(-12, 5, (50, 6))
    for count in range(1, 1001):
        g = (rng.normal(size=(50, 6)) * size).astype(np.float32)
        wide, moments = reference.step(wide, g.astype(np.float64), moments, 1e-3, count)
        update(state, g, adam.factors(1e-3, count))
    assert_close(state.parameter, wide, 1e-5 * np.maximum(np.abs(wide), 1), "parameter")


def test_works_in_place():
    state, gradient = zero_state(100_000, 5, start=1.0), np.ones((100_000, 5), np.float32)
    tracemalloc.start()
    update(state, gradient, adam.factors(0.1, 1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.4 * gradient.nbytes, "one temporary of the parameter's size, and no other"
    assert_close(state.parameter, np.full((100_000, 5), 0.9), 1e-6, "parameter")


def test_extreme_gradients_stay_finite():
    sizes = np.float32([0, 1e-30, 1e-20, 1e-10, 1, 1e10, -1e10, -1e-30])
    state = zero_state(8)
    for count in range(1, 21):
        update(state, sizes, adam.factors(0.01, count))
    assert np.isfinite(state.parameter).all()
    assert_close(state.parameter[3:7], [-0.2, -0.2, -0.2, 0.2], 1e-5, "parameter")


def test_idle_moments_become_zero():
    state = zero_state(10)
    update(state, np.full(10, 1e-3, np.float32), adam.factors(0.01, 1))
    for count in range(2, 702):
        update(state, np.zeros(10, np.float32), adam.factors(0.01, count))
    assert not state.first.any()


def test_wrong_shapes_are_refused():
    state, now = zero_state(6, 2), adam.factors(0.1, 1)
    with pytest.raises(ValueError, match="gradient"):
        update(state, np.zeros((6, 3), np.float32), now)
    with pytest.raises(ValueError, match="parameter: float64"):
        update(state._replace(parameter=np.zeros((6, 2))), np.zeros((6, 2), np.float32), now)


def test_a_set_stop_flag_changes_nothing(cpu):
    parameter, stop = cpu.zeros((4, 3)), cpu.upload(np.ones(1, np.int32))
    moments, ones = adam.zero_moments(cpu, parameter), cpu.upload(np.ones((4, 3), np.float32))
    now = adam.factors(0.1, 1)
    trained = adam.Trained(parameter, ones, moments)
    numpy_adam.step(cpu, [adam.Update(trained, now)], stop)
    numpy_adam.step_rows(cpu, trained, now, stop, cpu.upload(np.ones(4, np.int32)))
    assert not cpu.download(parameter).any()
    cpu.fill_zero(stop)
    numpy_adam.step(cpu, [adam.Update(trained, now, slice(3, 6))], stop)
    assert cpu.download(parameter).any(axis=1).tolist() == [False, True, False, False]
    assert cpu.download(moments.second).any(axis=1).tolist() == [False, True, False, False]


def rounds_correctly(device, rng):
    """Whether division and roots of ``device``, as the kernels use them, are those of IEEE 754."""
    g = (rng.normal(size=4096) * 10.0 ** rng.uniform(-6, 6, 4096)).astype(np.float32)
    parameter, gradient = device.zeros((4096,)), device.upload(g)
    moments, now = adam.zero_moments(device, parameter), adam.factors(0.01, 3)
    trained = adam.Trained(parameter, gradient, moments)
    adam.step(device, [adam.Update(trained, now)], adam.stop_flag(device))
    first, second = (device.download(one) for one in (moments.first, moments.second))
    root = np.sqrt(second) * np.float32(now.correction) + np.float32(adam.EPSILON)
    return np.array_equal(device.download(parameter), -(first / root * np.float32(now.step)))


STEPS = 120
"""One change of the anchors at step 100, and the switch to integers at step 60."""


def config(optimizer, rows):
    short = preset("default").scaled(STEPS)
    return replace(
        short, voxel=0.05, optimizer=optimizer, adam=rows, log_interval=40, size_lambda=0.05
    )


@pytest.fixture(scope="module")
def whole(dataset, open_device, tmp_path_factory):
    """Results of the run that the host optimises, all rows in every step."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    return train_scene(dataset, folder, config("numpy", "dense"), device=open_device("cpu"))


@pytest.mark.slow
@pytest.mark.parametrize("rows", ["dense", "visible"])
def test_a_run_has_the_same_bits(dataset, cpu, whole, tmp_path, rng, rows):
    if not rounds_correctly(cpu, rng):
        pytest.skip(f"{cpu.name} does not round division and roots correctly")
    results = [train_scene(dataset, tmp_path / "device", config("device", rows), device=cpu), whole]
    if rows == "visible":
        results[1] = train_scene(dataset, tmp_path / "numpy", config("numpy", rows), device=cpu)
    assert scene_hash(results[0].scene) == scene_hash(results[1].scene)
    assert results[0].bitstream == results[1].bitstream
    assert results[0].scene.anchors.offset.any(), "something was learned"


@pytest.mark.slow
def test_a_run_resumes_with_its_own_optimizer_alone(dataset, cpu, whole, tmp_path):
    def interrupt(progress):
        if progress.result.step == 70:
            raise KeyboardInterrupt

    wanted = replace(config("numpy", "dense"), checkpoint_interval=50)
    with pytest.raises(KeyboardInterrupt):
        train_scene(dataset, tmp_path / "legs", wanted, device=cpu, on_progress=interrupt)
    assert (tmp_path / "legs" / "checkpoint" / "step_00000050.npz").is_file()
    other = replace(wanted, optimizer="device")
    with pytest.raises(DataError, match="made with other settings"):
        train_scene(dataset, tmp_path / "legs", other, device=cpu, resume=True)
    legs = train_scene(dataset, tmp_path / "legs", wanted, device=cpu, resume=True)
    assert legs.bitstream == whole.bitstream
