"""What counts as a wait."""

from __future__ import annotations

import pyopencl as cl
import pytest

from clgs.opencl.waits import Waits


class Event:
    def __init__(self, status):
        self.command_execution_status = status

    def wait(self):
        if self.command_execution_status < 0:
            raise ValueError("the command failed")


def test_a_wait_for_what_is_complete_is_none():
    status, waits = cl.command_execution_status, Waits()
    waits.wait(Event(status.COMPLETE))
    assert (waits.count, waits.seconds) == (0, 0.0)
    waits.wait(Event(status.RUNNING))
    assert (waits.count, waits.seconds >= 0) == (1, True)
    with pytest.raises(ValueError, match="failed"):
        waits.wait(Event(-5))
