"""Calls of the driver that say, if the device is lost, what helps."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import pyopencl as cl

from clgs.errors import LostDeviceError
from clgs.explain import LOST

Given = ParamSpec("Given")
Result = TypeVar("Result")


def tells_of_loss(call: Callable[Given, Result]) -> Callable[Given, Result]:
    """``call``, which raises LostDeviceError if the driver says that the device is lost."""

    @functools.wraps(call)
    def checked(*given: Given.args, **named: Given.kwargs) -> Result:
        try:
            return call(*given, **named)
        except cl.Error as error:
            said = str(error).strip().partition("\n")[0]
            if any(code in said for code in LOST):
                raise LostDeviceError(said) from error
            raise

    return checked
