"""Times of kernels by the device's clock, and what counts as a wait."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pytest

from clgs.opencl.driver_calls import Waits
from clgs.ops import adam


def check(device):
    """Launch one kernel."""
    stop = adam.stop_flag(device)
    adam.check_finite(device, [device.upload(np.ones(100_000, np.float32))], stop)
    return device.download(stop)[0]


def test_every_launch_in_the_block_has_a_time(device):
    check(device)
    launches = device.launches
    with device.timed_kernels() as times:
        assert check(device) == 0
        once = times.take()
        assert check(device) == 0
        assert check(device) == 0
        twice = times.take()
        assert times.take() == {}
    assert set(once) == set(twice) == {"adam_check"}
    assert once["adam_check"] > 0
    assert device.launches - launches == 3


def upload_and_fail(device, found):
    with device.timed_kernels():
        found.append(device.upload(np.arange(1000, dtype=np.float32)))
        raise ValueError("for a reason")


def test_after_the_block_all_is_as_before(device):
    queue, found = device.queue, []
    with pytest.raises(ValueError, match="for a reason"):
        upload_and_fail(device, found)
    assert device.queue is queue
    np.testing.assert_array_equal(device.download(found[0]), np.arange(1000))
    assert check(device) == 0


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
