"""The contract of a kernel's arguments: names and types, as its source declares them."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from types import SimpleNamespace

import numpy as np
import pytest

from clgs.opencl import programs
from clgs.opencl.device import Device
from clgs.opencl.kernel import signatures

SOURCE = """
#define ONE(n) __global float *sum##n, const float factor##n
/* Adds `by` times the weights to x: __kernel void not_this(int x) */
__kernel void add_weighted(__global float *x, __global const int *weight, const int count,
                           const float4 by EXTRA_PARAMETERS)
{
    const int i = get_global_id(0);
    if (i < count)
        x[i] += by.x * weight[i];
}
"""


@pytest.fixture(scope="module")
def opened():
    """A device, and its only kernel."""
    with pytest.MonkeyPatch.context() as patch:
        text = "#define EXTRA_PARAMETERS\n" + SOURCE
        patch.setattr(programs, "read_program", lambda name: text)
        device = Device(specialisation="cpu")
        yield device, device.kernel("add", "add_weighted")


@pytest.fixture
def given(opened):
    """Arguments that fit."""
    device, _ = opened
    return {
        "x": device.upload(np.arange(4, dtype=np.float32)),
        "weight": device.upload(np.array([1, 2, 3, 4], np.int32)),
        "count": np.int32(3),
        "by": np.array([10, 0, 0, 0], np.float32),
    }


@pytest.mark.parametrize("order", [1, -1])
def test_arguments_go_by_their_names(opened, given, order):
    device, kernel = opened
    device.run(kernel, (4,), (1,), **dict(list(given.items())[::order]))
    assert device.download(given["x"]).tolist() == [10, 21, 32, 3]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"count": None, "size": np.int32(3)}, "add_weighted has no argument size"),
        ({"stop": np.int32(0)}, "add_weighted has no argument stop"),
        ({"count": None}, "add_weighted lacks its argument count"),
        ({"count": np.float32(3)}, "count is a number of float32, the kernel takes a number of in"),
        ({"count": np.int64(3)}, "count is a number of int64, the kernel takes a number of int32"),
        ({"count": 3}, "count is of type int, the kernel takes a number of int32"),
        ({"by": np.float32(3)}, "by is a number of float32, .* takes a vector of 4 float32"),
        ({"by": np.zeros(3, np.float32)}, "by is a vector of 3 float32, .* vector of 4 float32"),
        ({"by": np.zeros(4, np.float64)}, "by is a vector of 4 float64, .* vector of 4 float32"),
        ({"x": np.float32(3)}, "x is a number of float32, the kernel takes an array of float32"),
    ],
)
def test_what_does_not_fit_is_an_error(opened, given, change, complaint):
    device, kernel = opened
    arguments = {name: value for name, value in {**given, **change}.items() if value is not None}
    with pytest.raises(TypeError, match=complaint):
        device.run(kernel, (4,), (1,), **arguments)


def test_arrays_that_changed_places_are_an_error(opened, given):
    device, kernel = opened
    swapped = {**given, "x": given["weight"], "weight": given["x"]}
    with pytest.raises(TypeError, match="x is an array of int32, the kernel takes an array of fl"):
        device.run(kernel, (4,), (1,), **swapped)


def test_a_number_in_place_of_an_array_is_an_error_in_every_launch(opened, given):
    device, kernel = opened
    device.run(kernel, (4,), (1,), **given)
    with pytest.raises(TypeError, match="count is an array of int32"):
        device.run(kernel, (4,), (1,), **{**given, "count": given["weight"]})


@pytest.mark.parametrize(
    ("condition", "names"),
    [
        ("#ifdef NONE", "x weight count by"),
        ("#ifndef NONE", "x weight count by sum0 factor0 sum1 factor1"),
        ("#if WIDTH > 3 && !defined(NONE)", "x weight count by sum0 factor0 sum1 factor1"),
        ("#if (WIDTH % 2 == 1) || NONE", "x weight count by"),
        ("#if 0\n#elif WIDTH == 4u", "x weight count by sum0 factor0 sum1 factor1"),
        ("#if WIDTH == 4\n#define EXTRA_PARAMETERS\n#elif 1", "x weight count by"),
    ],
)
def test_conditions_and_macros_are_followed(condition, names):
    text = f"""{condition}
#define EXTRA_PARAMETERS , ONE(0), \\
    ONE(1)
#elif !defined(EXTRA_PARAMETERS)
#define EXTRA_PARAMETERS
#endif
{SOURCE}"""
    (found,) = signatures(text, {"WIDTH": "4"}).values()
    assert " ".join(one.name for one in found) == names
    assert [str(one) for one in found[:4]] == [
        "an array of float32",
        "an array of int32",
        "a number of int32",
        "a vector of 4 float32",
    ]


@pytest.mark.parametrize("parameter", ["fv x", "__global float x", "float *x", "float", "void"])
def test_parameters_of_other_types_are_an_error(parameter):
    with pytest.raises(ValueError, match="is neither pointer, number nor vector"):
        signatures(f"__kernel void any({parameter}) {{}}", {})


def test_a_condition_that_is_not_understood_is_an_error():
    with pytest.raises(ValueError, match="not understood"):
        signatures("#if WIDTH << 2\n#endif", {"WIDTH": "4"})


def test_threads_launch_a_kernel_one_after_the_other(device):
    """pyopencl sets the arguments of a kernel before it launches it: others would mix theirs in."""
    inside, most = [], []

    def built(*_):
        inside.append(1)
        time.sleep(0.05)
        most.append(len(inside))
        inside.pop()

    kernel = SimpleNamespace(built=built, ordered=lambda _: [], name="slow", lock=Lock())
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda _: device.run(kernel, (1,), None), range(3)))
    assert most == [1, 1, 1]
