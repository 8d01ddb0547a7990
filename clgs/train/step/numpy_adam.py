"""Adam in float32 NumPy on the host: the same numbers as the fused kernel of ``clgs.ops.adam``.

:func:`step` and :func:`step_rows` take what those of ``clgs.ops.adam`` take, and
leave the same bits if the device rounds division and roots correctly. They wait for the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops.adam import (
    EPSILON,
    MIN_FIRST_MOMENT,
    MIN_SECOND_MOMENT,
    StepFactors,
    Trained,
    Update,
)

Array = npt.NDArray[np.float32]


class HostTensors(NamedTuple):
    """A parameter and the running means of its gradient and of the gradient's square, one shape."""

    parameter: Array
    first: Array
    second: Array


def step(device: Device, updates: Sequence[Update], stop: DeviceArray) -> None:
    """Do what :func:`clgs.ops.adam.step` does.

    Raises:
        ValueError: sizes or dtypes differ.
    """
    if device.download(stop)[0]:
        return
    for one in updates:
        one.trained.check()
        state, chosen = _download(device, one.trained), one.part or slice(None)
        views = HostTensors._make(array.reshape(-1)[chosen] for array in state)
        update(views, device.download(one.trained.gradient).reshape(-1)[chosen], one.now)
        _write(device, one.trained, state)


def step_rows(
    device: Device,
    trained: Trained,
    factors_now: StepFactors,
    stop: DeviceArray,
    marks: DeviceArray,
) -> None:
    """Do what :func:`clgs.ops.adam.step_rows` does: update only the rows that are marked.

    Raises:
        ValueError: sizes or dtypes differ.
    """
    if device.download(stop)[0]:
        return
    moved = device.download(marks) != 0
    trained.check()
    state = _download(device, trained)
    rows = HostTensors._make(array[moved] for array in state)
    gradient = device.download(trained.gradient).reshape(trained.parameter.shape)
    update(rows, gradient[moved], factors_now)
    for array, changed in zip(state, rows, strict=True):
        array[moved] = changed
    _write(device, trained, state)


def update(state: HostTensors, gradient: Array, factors_now: StepFactors) -> None:
    """One step of Adam in place on ``state``; ``gradient`` is float32 of its shape.

    Raises:
        ValueError: a shape or dtype differs.
    """
    shape = state.parameter.shape
    for name, array in (*state._asdict().items(), ("gradient", gradient)):
        if array.shape != shape or array.dtype != np.float32:
            raise ValueError(f"{name}: {array.dtype}{array.shape}, expected float32{shape}")
    betas = factors_now.betas
    first, second, scratch = state.first, state.second, np.empty_like(state.first)
    first *= np.float32(betas.first)
    np.multiply(gradient, np.float32(1.0 - betas.first), out=scratch)
    first += scratch
    second *= np.float32(betas.second)
    with np.errstate(under="ignore", over="ignore"):
        np.multiply(gradient, gradient, out=scratch)
    scratch *= np.float32(1.0 - betas.second)
    second += scratch
    # a product with 0 or 1 flushes without a temporary, and keeps a NaN
    np.abs(first, out=scratch)
    np.greater_equal(scratch, np.float32(MIN_FIRST_MOMENT), out=scratch)
    first *= scratch
    np.greater_equal(second, np.float32(MIN_SECOND_MOMENT), out=scratch)
    second *= scratch
    np.sqrt(second, out=scratch)
    scratch *= np.float32(factors_now.correction)
    scratch += np.float32(EPSILON)
    np.divide(first, scratch, out=scratch)
    scratch *= np.float32(factors_now.step)
    np.subtract(state.parameter, scratch, out=state.parameter)


def _download(device: Device, trained: Trained) -> HostTensors:
    """Host copies, of the parameter's shape."""
    arrays = (trained.parameter, trained.moments.first, trained.moments.second)
    return HostTensors._make(
        device.download(array).reshape(trained.parameter.shape) for array in arrays
    )


def _write(device: Device, trained: Trained, state: HostTensors) -> None:
    device.write(trained.parameter, state.parameter)
    device.write(trained.moments.first, state.first)
    device.write(trained.moments.second, state.second)
