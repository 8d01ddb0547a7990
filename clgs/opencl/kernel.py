"""A kernel, and the contract of its arguments: a launch names them, the kernel's source types them.

A wrong name, a missing or a further one, and a wrong type are errors before anything runs.
"""

from __future__ import annotations

from threading import Lock
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from clgs.opencl.array import DeviceArray
from clgs.opencl.signature import Parameter

Argument: TypeAlias = DeviceArray | np.generic | npt.NDArray[Any]
"""An array on the device, a number, or a vector of 2 to 16 numbers."""


class Kernel:
    """A kernel that was built, and its parameters in order."""

    def __init__(self, built: cl.Kernel, parameters: tuple[Parameter, ...]) -> None:
        """``built`` from a source that declares ``parameters``."""
        self.name = str(built.function_name)
        self.built = built
        self.lock = Lock()  # of its arguments: other threads must not set theirs before the launch
        self.parameters = parameters
        self._names = [one.name for one in parameters]
        self._dtypes = [one.dtype for one in parameters]
        self._types = [_type(one) for one in parameters]
        self._arrays = [i for i, one in enumerate(parameters) if one.space]
        self._vectors = [(i, (one.lanes,)) for i, one in enumerate(parameters) if one.lanes > 1]
        # pyopencl asks nothing of arguments whose types it knows
        built.set_arg_types([None if one.space else _packed(one) for one in parameters])

    def ordered(self, arguments: dict[str, Any]) -> list[Any]:
        """What pyopencl takes, in the kernel's order.

        Raises:
            TypeError: a name or a type is not that of the kernel's parameter.
        """
        try:
            values = [arguments[name] for name in self._names]
        except KeyError:
            raise self._complaint(arguments) from None
        if (
            len(values) != len(arguments)
            or [type(value) for value in values] != self._types
            or [value.dtype for value in values] != self._dtypes
        ):
            raise self._complaint(arguments)
        for i, shape in self._vectors:
            if values[i].shape != shape:
                raise self._complaint(arguments)
        for i in self._arrays:
            values[i] = values[i].buffer
        return values

    def _complaint(self, arguments: dict[str, Any]) -> TypeError:
        for name in arguments:
            if name not in self._names:
                return TypeError(f"kernel {self.name} has no argument {name}")
        for parameter in self.parameters:
            if parameter.name not in arguments:
                return TypeError(f"kernel {self.name} lacks its argument {parameter.name}")
            found = _described(arguments[parameter.name])
            if found != str(parameter):
                return TypeError(
                    f"kernel {self.name}: argument {parameter.name} is {found}, "
                    f"the kernel takes {parameter}"
                )
        return TypeError(f"kernel {self.name}: an argument does not fit")


def _type(parameter: Parameter) -> type:
    if parameter.space:
        return DeviceArray
    return np.ndarray if parameter.lanes > 1 else parameter.dtype.type


def _packed(parameter: Parameter) -> np.dtype[Any]:
    """How pyopencl passes a number; a vector goes as the bytes that it is."""
    whole = np.dtype((np.void, parameter.lanes * parameter.dtype.itemsize))
    return whole if parameter.lanes > 1 else parameter.dtype


def _described(value: Any) -> str:
    """A given argument, in the words of ``str(Parameter)``."""
    if isinstance(value, DeviceArray):
        return f"an array of {value.dtype}"
    if isinstance(value, np.generic):
        return f"a number of {value.dtype}"
    if isinstance(value, np.ndarray) and value.ndim == 1:
        return f"a vector of {len(value)} {value.dtype}"
    return f"of type {type(value).__name__}"
