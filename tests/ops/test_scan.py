"""Prefix sums: exact equality with the reference, 64-bit totals."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.ops import scan
from clgs.reference import scan as reference


@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 100_003])
def test_equals_reference(device, rng, count):
    counts = rng.integers(0, 50, count, dtype=np.int32)
    offsets, total = scan.exclusive(device, device.upload(counts))
    expected, expected_total = reference.exclusive(counts)
    assert offsets.shape == (count,)
    assert np.array_equal(device.download(offsets), expected)
    assert total == expected_total


def test_last_entry_is_the_total(device):
    result = scan.on_device(device, device.upload(np.arange(5, dtype=np.int32)))
    assert device.download(result.offset).tolist() == [0, 0, 1, 3, 6, 10]
    assert device.download(result.total).tolist() == [10]


def test_other_dtype_is_refused(device):
    with pytest.raises(TypeError, match="counts"):
        scan.exclusive(device, device.upload(np.zeros(3, np.uint32)))


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize(("total", "room"), [(7, 8), (8, 8), (9, 8), (2**31 + 8, 8)])
def test_short_room_sets_the_stop_flag(device, total, room, place):
    stop = device.upload(np.array([1], np.int32))
    wanted = 1 | (scan.LACKS_ROOM if total > room else 0)
    totals, none = np.array([3, 0, 5]), device.upload(np.array([0]))
    totals[place] = total
    gathered = scan.check_fits(
        device, tuple(device.upload(one) for one in totals[:, None]), (room,) * 3, stop
    )
    assert np.array_equal(device.download(gathered), totals)
    assert device.download(stop)[0] == wanted
    scan.check_fits(device, (none, none, none), (room,) * 3, stop)
    assert device.download(stop)[0] == wanted  # and it stays
