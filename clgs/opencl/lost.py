"""Calls of the driver that say, if the device is lost, what helps.

A process that was forked from one with an open device has lost it: the driver's threads are not in
the copy, and a call would wait for them for ever.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import pyopencl as cl

from clgs.errors import DeviceError, LostDeviceError
from clgs.explain import LOST

Given = ParamSpec("Given")
Result = TypeVar("Result")


_opened: list[bool] = []
_forked: list[bool] = []
"""Each has an element if it is so: a device was opened; this is a fork made after that."""


def note_opened() -> None:
    """Note that a device is opened.

    Raises:
        DeviceError: this process is a fork of one that has opened one.
    """
    _refuse_fork()
    if not _opened:
        _opened.append(True)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=lambda: _forked.append(True))


def _refuse_fork() -> None:
    if _forked:
        raise DeviceError(
            "this process was forked from one that had opened an OpenCL device, which is lost: "
            'start processes by multiprocessing.get_context("spawn"), or fork before first use'
        )


def tells_of_loss(call: Callable[Given, Result]) -> Callable[Given, Result]:
    """``call``, which raises LostDeviceError if the driver says that the device is lost.

    In a fork of the process that opened the device it raises DeviceError.
    """

    @functools.wraps(call)
    def checked(*given: Given.args, **named: Given.kwargs) -> Result:
        if _forked:
            _refuse_fork()
        try:
            return call(*given, **named)
        except cl.Error as error:
            said = str(error).strip().partition("\n")[0]
            if any(code in said for code in LOST):
                raise LostDeviceError(said) from error
            raise

    return checked
