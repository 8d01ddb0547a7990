"""Copies between host and device that do not wait for the kernels before them."""

from __future__ import annotations

import math
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from clgs.opencl.array import DeviceArray
from clgs.opencl.driver_calls import Waits, is_complete, tells_of_loss

LARGEST_PATTERN = 128
"""Bytes that a fill command takes along, so that nothing on the host must be kept for it."""

FILLED_SIZE = 2 * LARGEST_PATTERN
"""Arrays up to this many bytes are written by fills."""

WAITING_SIZE = 1 << 22
"""Larger arrays are written at once: a private copy of them would cost more than the wait."""


PINNED_SIZE = 1 << 10
PINNED_PLACES = 64
"""Bytes of the largest array that is read into pinned memory, and how many such have room."""


class Download:
    """A pending copy to the host."""

    def __init__(self, host: npt.NDArray[Any], event: Any, waits: Waits, lent: bool) -> None:
        """``event`` is None if there is nothing to copy; ``lent``: ``host`` will be used again."""
        self._host, self._event, self._waits, self._lent = host, event, waits, lent

    def get(self) -> npt.NDArray[Any]:
        """The array; waits for the copy."""
        if self._event is not None:
            self._waits.wait(self._event)
        if self._lent:
            self._host, self._lent = self._host.copy(), False
        return self._host


class PinnedMemory:
    """Memory of the host that a card writes to by itself, in places for small arrays.

    Drivers wait for the work before a read into other memory, even if they were asked not to.
    """

    def __init__(self, queue: Any) -> None:
        """Allocate it."""
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR
        self._buffer = cl.Buffer(queue.context, flags, PINNED_PLACES * PINNED_SIZE)
        mapped: Any = cl.map_flags.READ | cl.map_flags.WRITE
        shape = PINNED_PLACES, PINNED_SIZE
        self._places, _ = cl.enqueue_map_buffer(
            queue, self._buffer, mapped, 0, shape, np.dtype(np.uint8)
        )
        self._users: list[Any] = [lambda: None] * PINNED_PLACES
        self._next = 0

    def read(self, queue: Any, array: DeviceArray, waits: Waits) -> Download:
        """Copy ``array``, of PINNED_SIZE bytes at most, to the next place."""
        number, self._next = self._next, (self._next + 1) % PINNED_PLACES
        last = self._users[number]()
        if last is not None:
            last.get()
        place = self._places[number, : array.nbytes]
        event = cl.enqueue_copy(queue, place, array.buffer, is_blocking=False)
        download = Download(place.view(array.dtype).reshape(array.shape), event, waits, lent=True)
        self._users[number] = weakref.ref(download)
        return download


class MappedView:
    """An array of the device, mapped for reading."""

    def __init__(self, queue: Any, array: DeviceArray, waits: Waits) -> None:
        """Begin to map an array that is not empty; does not wait."""
        self._queue, self._waits = queue, waits
        self._view, self._event = cl.enqueue_map_buffer(
            queue, array.buffer, cl.map_flags.READ, 0, array.shape, array.dtype, is_blocking=False
        )

    def get(self) -> npt.NDArray[Any]:
        """The view; waits until it can be read."""
        self._waits.wait(self._event)
        return np.asarray(self._view)

    def release(self) -> None:
        """Unmap it: the view must not be read any more."""
        self._view.base.release(self._queue)


class _Mapped:
    """Device memory as NumPy's array interface shows it; keeps it mapped and out of the pool."""

    def __init__(self, queue: Any, array: DeviceArray) -> None:
        """Begin to map it; does not wait."""
        flags: Any = cl.map_flags.READ | cl.map_flags.WRITE
        view, self.event = cl.enqueue_map_buffer(
            queue, array.buffer, flags, 0, array.shape, array.dtype, is_blocking=False
        )
        self.__array_interface__ = view.__array_interface__
        self._view, self._array = view, array


class Transfers:
    """Writes and reads of one queue; keeps host arrays alive until commands are complete."""

    def __init__(self, queue: Any, waits: Waits, pinned: PinnedMemory | None) -> None:
        """``queue`` executes in order; ``waits`` counts those for it; ``pinned``: for reads."""
        self._queue, self._waits, self._pinned = queue, waits, pinned
        self._under_way: deque[Any] = deque()
        self._lock = Lock()

    @tells_of_loss
    def write(self, buffer: Any, host: npt.NDArray[Any]) -> None:
        """Overwrite the first ``host.nbytes`` bytes of ``buffer``."""
        if host.nbytes <= FILLED_SIZE:
            # patterns of falling powers of two, so that each starts at a multiple of its size
            content = np.ascontiguousarray(host).reshape(-1).view(np.uint8)
            start, size = 0, LARGEST_PATTERN
            while start < len(content):
                while size > len(content) - start:
                    size //= 2
                pattern = content[start : start + size]
                cl.enqueue_fill_buffer(self._queue, buffer, pattern, start, size)
                start += size
        elif host.nbytes > WAITING_SIZE:
            cl.enqueue_copy(self._queue, buffer, np.ascontiguousarray(host))
        else:
            self.write_constant(buffer, np.array(host, order="C"))

    @tells_of_loss
    def write_constant(self, buffer: Any, host: npt.NDArray[Any]) -> None:
        """Write an array that never changes; does not wait."""
        constant = np.ascontiguousarray(host)
        # hold event, which holds its host array; release those that are complete
        with self._lock:
            while self._under_way and is_complete(self._under_way[0]):
                self._under_way.popleft()
        self._under_way.append(cl.enqueue_copy(self._queue, buffer, constant, is_blocking=False))

    @tells_of_loss
    def read(self, array: DeviceArray) -> Download:
        """Copy ``array`` to the host when the commands before are through."""
        if self._pinned and 0 < array.nbytes <= PINNED_SIZE:
            return self._pinned.read(self._queue, array, self._waits)
        host = np.empty(array.shape, array.dtype)
        if not array.nbytes:
            return Download(host, None, self._waits, lent=False)
        event = cl.enqueue_copy(self._queue, host, array.buffer, is_blocking=False)
        return Download(host, event, self._waits, lent=False)

    @tells_of_loss
    def map(self, array: DeviceArray) -> MappedView:
        """``array``, which is not empty, for the host to read where it is."""
        return MappedView(self._queue, array, self._waits)

    @tells_of_loss
    def hand_over(self, arrays: Sequence[DeviceArray]) -> Callable[[], list[npt.NDArray[Any]]]:
        """The memory of arrays as arrays of the host; the result waits, once for all."""
        places = [(one, 0) if one.part is None else one.part for one in arrays]
        wholes = {id(whole): whole for whole, _ in places if whole.nbytes}
        mapped = {key: _Mapped(self._queue, whole) for key, whole in wholes.items()}
        last = next((one.event for one in reversed(mapped.values())), None)

        def wait() -> list[npt.NDArray[Any]]:
            if last is not None:
                self._waits.wait(last)
            hosts = {key: np.asarray(one) for key, one in mapped.items()}
            return [
                np.ndarray(one.shape, one.dtype, hosts.get(id(whole)), begin)  # empty ones: None
                for one, (whole, begin) in zip(arrays, places, strict=True)
            ]

        return wait


def part_of(whole: DeviceArray, begin: int, shape: tuple[int, ...]) -> DeviceArray:
    """An array of float32 from byte ``begin`` of an array of bytes on, in the same memory."""
    memory: Any = cl.Buffer.from_int_ptr(whole.buffer.int_ptr, retain=True)  # pools have no regions
    region = memory.get_sub_region(begin, 4 * max(math.prod(shape), 1))
    return DeviceArray(region, shape, np.dtype(np.float32), (whole, begin))
