"""Copies that do not wait."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.opencl.transfer import (
    FILLED_SIZE,
    PINNED_PLACES,
    PINNED_SIZE,
    WAITING_SIZE,
    PinnedMemory,
    Transfers,
)


@pytest.mark.parametrize("count", [1, 3, 104, 128, 255, FILLED_SIZE, FILLED_SIZE + 1, 5000])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_any_size_arrives(device, rng, count, dtype):
    host = rng.integers(0, 256, count).astype(dtype)
    assert np.array_equal(device.download(device.upload(host)), host)


@pytest.mark.parametrize("nbytes", [64, 5000, WAITING_SIZE + 1])
def test_host_array_may_change_after_a_write(device, nbytes):
    host = np.full(nbytes, 7, np.uint8)
    array = device.upload(host)
    host[:] = 9
    assert (device.download(array) == 7).all()


def test_parts_of_arrays_and_other_orders_arrive(device, rng):
    host = rng.normal(size=(40, 30)).astype(np.float32)
    for part in (host.T, host[::2, 3:5], host[:3, :5].T):
        assert np.array_equal(device.download(device.upload(part)), part)


def test_later_downloads_hold_the_state_at_their_call(device):
    array = device.upload(np.arange(1000, dtype=np.int32))
    first = device.download_later(array)
    device.fill_zero(array)
    second = device.download_later(array)
    assert np.array_equal(first.get(), np.arange(1000))
    assert not second.get().any()
    assert device.download_later(device.empty((0, 3))).get().shape == (0, 3)


@pytest.mark.parametrize("nbytes", [4, 24, PINNED_SIZE, PINNED_SIZE + 4])
def test_pinned_memory_holds_any_number_of_reads(device, nbytes):
    """Some are dropped, most outlive the places, and what was got stays as it is."""
    transfers = Transfers(device.queue, device.waits, PinnedMemory(device.queue))
    count = 3 * PINNED_PLACES
    arrays = [device.upload(np.full(nbytes // 4, number, np.int32)) for number in range(count)]
    reads = [transfers.read(array) for array in arrays]
    del reads[5::7]
    wanted = [number for number in range(count) if number % 7 != 5]
    found = [read.get() for read in reads]
    again = [transfers.read(array) for array in arrays[::-1]]
    assert [set(values.tolist()) for values in found] == [{number} for number in wanted]
    assert again[0].get()[0] == count - 1
    assert reads[0].get() is found[0]


@pytest.mark.parametrize("first", [0, 1, 4, 16])
@pytest.mark.parametrize("count", [3, 20, 64])
def test_fills_begin_where_they_are_told(device, first, count):
    array = device.upload(np.full(count, 7, np.uint8))
    device.fill_zero(array, first)
    assert device.download(array).tolist() == [7] * min(first, count) + [0] * max(count - first, 0)


def test_handed_over_memory_is_kept_while_any_view_of_it_lives(device, rng):
    host = rng.normal(size=(3, 50, 70)).astype(np.float32)
    for shape in [(3, 50, 70), (0, 3)]:
        part = host if 0 not in shape else np.empty(shape, np.float32)
        views = [device.hand_over(device.upload(part))[..., 1:] for _ in range(4)]
        others = [device.zeros(shape) for _ in range(8)]
        device.finish()
        assert all(np.array_equal(view, part[..., 1:]) for view in views)
        assert all(not device.download(other).any() for other in others)


def test_handed_over_memory_goes_back_to_the_pool(device):
    def pictures() -> int:
        for _ in range(20):
            device.hand_over(device.zeros((300, 1000)))[0, 0] = 1
        return device.reserved_bytes

    before = pictures()
    assert pictures() == before


def test_arrays_made_together_are_handed_over_alone_or_with_others(device, rng):
    """Their memory stays theirs as long as a host's array of one lives."""
    shapes = {"a": (300, 2), "b": (0, 3), "none": None, "c": (7,), "d": (300,)}
    made = device.empty_together(**shapes)
    assert made.pop("none") is None
    values = {name: rng.normal(size=one.shape).astype(np.float32) for name, one in made.items()}
    for name, array in made.items():
        device.write(array, values[name])
    other = device.upload(np.arange(5, dtype=np.int32))
    found = device.hand_over_all([made["d"], other, made["b"], made["a"]])
    assert np.array_equal(found[1], np.arange(5))
    assert np.array_equal(device.download(made["c"].first(3)), values["c"][:3])
    assert made["a"].of_type(np.int32).dtype == np.int32
    found = dict(zip("dba", [found[0], *found[2:]], strict=True)) | {
        "c": device.hand_over(made.pop("c"))
    }
    made.clear()
    again = device.empty_together(**{name: one for name, one in shapes.items() if one})
    for array in again.values():
        device.fill_zero(array)
    device.finish()
    for name, array in found.items():
        assert np.array_equal(array, values[name]), name
