"""The device layer: arrays, kernels, errors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest

from clgs.errors import DeviceError, LostDeviceError, UsageError
from clgs.opencl import programs
from clgs.opencl.device import Device, round_up
from clgs.ops import batch

SCALE = """
#ifndef FACTOR
#define FACTOR 2.0f
#endif
__kernel void scale_forward(__global float *x, int count)
{
    int i = get_global_id(0);
    if (i < count)
        x[i] *= FACTOR;
}
"""


@pytest.fixture
def program(monkeypatch):
    """Call it with a name and a text: the only program that the device layer then finds."""

    def install(name: str, text: str) -> None:
        def read(wanted: str) -> str:
            assert wanted == f"{name}.cl"
            return f'#line 1 "{wanted}"\n{text}'

        monkeypatch.setattr(programs, "read_program", read)

    return install


@pytest.fixture
def fresh_device():
    """A device whose kernel cache holds nothing yet."""
    return Device(specialisation="cpu")


def test_a_device_that_is_too_small_is_refused(monkeypatch):
    monkeypatch.setattr("clgs.opencl.device.too_small", lambda device: "it has no local memory")
    with pytest.raises(DeviceError, match="cannot be used: it has no local memory; use another"):
        Device()


@pytest.mark.parametrize("where", ["run", "wait", "finish", "fill", "copy"])
def test_a_lost_device_says_what_helps(fresh_device, monkeypatch, where):
    array, said = fresh_device.upload(np.ones(300, np.float32)), "failed: OUT_OF_RESOURCES"

    def fail(*arguments, **named):
        raise cl.RuntimeError(said)

    calls = {
        "run": lambda: batch.add(fresh_device, array, array),
        "wait": lambda: fresh_device.download(array),
        "finish": fresh_device.finish,
        "fill": lambda: fresh_device.fill_zero(array),
        "copy": lambda: fresh_device.download(array),
    }
    calls["run"]()
    broken = SimpleNamespace(finish=fail, wait=fail, command_execution_status=0)
    monkeypatch.setattr(cl.Kernel, "__call__", fail)
    monkeypatch.setattr(cl, "enqueue_fill_buffer", fail)
    monkeypatch.setattr(cl, "enqueue_copy", (lambda *a, **k: broken) if where == "wait" else fail)
    monkeypatch.setattr(fresh_device, "queue", broken)
    with pytest.raises(LostDeviceError, match=rf"lost \({said}\), .* start another one"):
        calls[where]()
    said = "failed: INVALID_VALUE"
    with pytest.raises(cl.RuntimeError, match=said):
        calls[where]()


def test_first_rows_share_the_memory(device):
    array = device.upload(np.arange(12, dtype=np.int32).reshape(4, 3))
    rows = array.first(2)
    device.fill_zero(array.first(1))
    assert device.download(rows).tolist() == [[0, 0, 0], [3, 4, 5]]
    assert device.download(array)[2:].tolist() == [[6, 7, 8], [9, 10, 11]]


@pytest.mark.parametrize("dtype", [np.float32, np.int32, np.uint8, np.uint32])
@pytest.mark.parametrize("shape", [(), (1,), (7,), (5, 3), (2, 3, 4), (0,), (0, 3), (4, 0)])
def test_arrays_come_back_as_they_went(device, rng, dtype, shape):
    host = rng.integers(0, 200, shape).astype(dtype)
    array = device.upload(host)
    assert (array.shape, array.dtype, array.nbytes) == (host.shape, host.dtype, host.nbytes)
    back = device.download(array)
    assert back.dtype == host.dtype
    np.testing.assert_array_equal(back, host)


def test_every_bit_pattern_survives(device):
    host = np.array([0x7FC00001, 0x00000001, 0x80000000, 0xFF800000], np.uint32).view(np.float32)
    back = device.download(device.upload(host))
    np.testing.assert_array_equal(back.view(np.uint32), host.view(np.uint32))


@pytest.mark.parametrize("shape", [(1000, 3), (3,), (0, 3)])
def test_zeros_clears_memory_that_was_used_before(device, shape):
    used = device.upload(np.full(shape, 7.0, np.float32))
    del used
    np.testing.assert_array_equal(device.download(device.zeros(shape)), np.zeros(shape))


def test_writing_another_size_or_type_is_refused(device):
    array = device.zeros((4,))
    for wrong in (np.zeros(5, np.float32), np.zeros(4, np.float64)):
        with pytest.raises(ValueError, match="cannot write"):
            device.write(array, wrong)


def test_memory_returns_with_the_array_and_stays_intact_while_it_lives(device):
    kept = device.upload(np.ones(1000, np.float32))
    for _ in range(100):
        device.upload(np.full(1000, 2.0, np.float32))
    np.testing.assert_array_equal(device.download(kept), np.ones(1000))


def test_the_same_kernel_is_the_same_object(fresh_device, program):
    program("scale", SCALE)
    kernel = fresh_device.kernel("scale", "scale_forward")
    assert fresh_device.kernel("scale", "scale_forward") is kernel
    assert fresh_device.kernel("scale", "scale_forward", FACTOR=3.0) is not kernel


def test_a_kernel_runs_with_its_macros(fresh_device, program):
    program("scale", SCALE)
    x = fresh_device.upload(np.arange(100, dtype=np.float32))
    size = round_up(100, 64)
    for factor in ({}, {"FACTOR": 0.1}):
        kernel = fresh_device.kernel("scale", "scale_forward", **factor)
        fresh_device.run(kernel, (size,), (64,), x=x, count=np.int32(100))
    expected = np.arange(100, dtype=np.float32) * np.float32(2.0) * np.float32(0.1)
    np.testing.assert_array_equal(fresh_device.download(x), expected)


def test_an_empty_launch_does_nothing(fresh_device, program):
    program("scale", SCALE)
    x = fresh_device.zeros((0,))
    kernel = fresh_device.kernel("scale", "scale_forward")
    fresh_device.run(kernel, (0,), None, x=x, count=np.int32(0))
    fresh_device.finish()


def test_a_build_error_names_file_and_line(fresh_device, program):
    program("scale", SCALE.replace("FACTOR;", "NONE;"))
    with pytest.raises(DeviceError) as caught:
        fresh_device.kernel("scale", "scale_forward")
    assert "kernels_cl/scale.cl" in str(caught.value)
    assert "scale.cl:9" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_specialisation_follows_argument_environment_and_type(monkeypatch):
    monkeypatch.setenv("CLGS_SPECIALISATION", "gpu")
    assert (Device().specialisation, Device().vec) == ("gpu", 1)
    assert (Device(specialisation="cpu").specialisation, Device(specialisation="cpu").vec) == (
        "cpu",
        16,
    )
    monkeypatch.setenv("CLGS_SPECIALISATION", "tpu")
    with pytest.raises(UsageError, match="CLGS_SPECIALISATION=tpu"):
        Device()


def test_lanes_follow_the_environment_and_the_form_of_the_kernels(monkeypatch):
    monkeypatch.setenv("CLGS_LANES", "8")
    narrow = Device(specialisation="cpu")
    assert (narrow.lanes, narrow.register_lanes) == (8, 8)
    monkeypatch.setenv("CLGS_LANES", "16")
    wide = Device(specialisation="cpu")
    assert (wide.lanes, wide.register_lanes) == (16, 16)
    assert Device(specialisation="gpu").lanes == 1
    monkeypatch.setenv("CLGS_LANES", "9")
    with pytest.raises(UsageError, match="CLGS_LANES=9: is not 8 or 16"):
        Device()


def test_floats_become_exact_float32_literals():
    for value in (0.1, 1e-30, 2.0, 1.0 / 255.0, 1e20):
        text = programs.literal(value)
        assert text.endswith("f")
        assert np.float32(text[:-1]) == np.float32(value)
    assert programs.literal(3) == "3"


def test_round_up():
    assert [round_up(n, 16) for n in (0, 1, 16, 17)] == [0, 16, 16, 32]


def test_profile_attributes_time_only_while_it_is_on(fresh_device):
    with fresh_device.stage("off"):
        pass
    fresh_device.profile.enabled = True
    for _ in range(2):
        with fresh_device.stage("on"):
            fresh_device.zeros((10,))
    ((name, calls, milliseconds, seconds),) = fresh_device.profile.rows()
    assert (name, calls) == ("on", 2)
    assert 0.0 < milliseconds <= 1e3 * seconds
    fresh_device.profile.clear()
    assert fresh_device.profile.rows() == []


def test_devices_share_what_is_built_in_their_context(monkeypatch):
    one, other = Device(), Device()
    one.kernel("loss/mask", "mask_apply", UNUSED=77)
    monkeypatch.setattr(programs.cl, "Program", None)
    assert other.kernel("loss/mask", "mask_apply", UNUSED=77) is not None
    elsewhere = programs.Programs(
        cl.Context([one.cl_device]), one.name, one.specialisation, one.vec, one.exact_division, True
    )
    with pytest.raises(TypeError):
        elsewhere.kernel("loss/mask", "mask_apply", {"UNUSED": 77})
