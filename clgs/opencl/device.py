"""One OpenCL device: its queue, memory pool, compiled kernels and specialisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl
import pyopencl.tools

from clgs.arguments import check_type
from clgs.errors import DeviceError, NoRoomError
from clgs.machine import return_unused_memory
from clgs.opencl.array import DeviceArray
from clgs.opencl.choose import (
    choose_device,
    form_of,
    has_exact_division,
    is_emulator,
    kind_of,
    serves_cpu_form,
    too_small,
    wanted_form,
    wanted_lanes,
)
from clgs.opencl.driver_calls import KernelTimes, Profile, Waits, note_opened, tells_of_loss
from clgs.opencl.kernel import Argument, Kernel
from clgs.opencl.programs import Programs, context_of
from clgs.opencl.transfer import Download, PinnedMemory, Transfers, part_of

POOL_BITS = {"cpu": 0, "gpu": 2}
"""Leading bits of a size, after the first one, that tell apart what the memory pool reuses."""

SHARED_ALIGNMENT = 16
"""Bytes: the host's arrays of NumPy and PyTorch that a CPU device can read where they are."""


class Device:
    """Runs kernels on one device, in order, and owns the memory that they use.

    ``specialisation`` selects the form of the kernels: "cpu" (vectors of ``vec`` lanes, one
    work-item per tile, no local memory) or "gpu" (scalars, work-groups, local memory).
    """

    def __init__(
        self,
        name: str | None = None,
        specialisation: str | None = None,
        cl_device: cl.Device | None = None,
    ) -> None:
        """Open a device.

        Args:
            name: as for :func:`clgs.opencl.choose.choose_device`.
            specialisation: "cpu" or "gpu"; default CLGS_SPECIALISATION, else by device type.
            cl_device: pyopencl's in place of a name, such as one of
                ``device.cl_device.create_sub_devices``.

        Raises:
            DeviceError: there is no such device, it is too small, or it was opened before a fork.
            UsageError: CLGS_SPECIALISATION is neither "cpu" nor "gpu", CLGS_LANES neither 8 nor 16.
            TypeError: ``name`` is no string.
        """
        if name is not None:
            check_type("name", name, str, 'a number is one, too: clgs.Device("0")')
        note_opened()
        self.cl_device = choose_device(name) if cl_device is None else cl_device
        if problem := too_small(self.cl_device):
            raise DeviceError(f"{self.name} cannot be used: {problem}; use another --device")
        self.context = context_of(self.cl_device)
        self.queue = cl.CommandQueue(self.context)
        is_cpu = bool(self.cl_device.type & cl.device_type.CPU)
        usual = serves_cpu_form(self.cl_device)
        self.specialisation = specialisation or wanted_form() or form_of(self.cl_device)
        self.vec = 16 if self.specialisation == "cpu" else 1
        width = int(self.cl_device.native_vector_width_float)
        self._register_lanes = wanted_lanes() or min(max(width, 4), 16)
        self._largest_array = int(self.cl_device.max_mem_alloc_size)
        self.profile = Profile()
        self.waits = Waits()
        """How often and how long downloads waited."""
        self._pinned = None if is_cpu else PinnedMemory(self.queue)
        self._transfers = Transfers(self.queue, self.waits, self._pinned)
        allocator = cl.tools.ImmediateAllocator(self.queue)
        # Sizes are rounded up, so that more arrays share memory: on a CPU, where memory that
        # nobody touches takes no room, to powers of two.
        bits = POOL_BITS["cpu" if is_cpu else "gpu"]
        self._pool = cl.tools.MemoryPool(allocator, leading_bits_in_bin_id=bits)
        self._programs = Programs(
            self.context, self.name, self.specialisation, self.vec, self.exact_division, usual
        )
        self._kernel_times: KernelTimes | None = None
        self.launches = 0
        """Kernels enqueued so far."""

    @property
    def exact_division(self) -> bool:
        """Whether division and square root can be, and so are, correctly rounded."""
        return has_exact_division(self.cl_device)

    @property
    def kind(self) -> str:
        """What its bits depend on: see :func:`clgs.opencl.choose.kind_of`."""
        return kind_of(self.cl_device, self.specialisation)

    @property
    def is_emulator(self) -> bool:
        """Whether this is an emulator that is too slow for anything but tiny scenes."""
        return is_emulator(self.cl_device)

    @property
    def has_few_registers(self) -> bool:
        """Whether this is a GPU of Intel: a work-item has half the registers that others have."""
        is_gpu = bool(self.cl_device.type & cl.device_type.GPU)
        return is_gpu and "intel" in self.cl_device.vendor.lower()

    @property
    def name(self) -> str:
        """Device name, without surrounding blanks."""
        return str(self.cl_device.name).strip()

    @property
    def lanes(self) -> int:
        """Lanes of vectors for kernels that hold many values: 8 or 16 on a CPU, else 1."""
        return max(8, self.register_lanes) if self.specialisation == "cpu" else 1

    @property
    def register_lanes(self) -> int:
        """Numbers of a register: 4, 8 or 16 on a CPU, or what CLGS_LANES says, else 1.

        Results have the same bits for any number.
        """
        return self._register_lanes if self.specialisation == "cpu" else 1

    @property
    def reserved_bytes(self) -> int:
        """Device memory that the pool holds, in use or kept for reuse: the most ever needed."""
        return int(self._pool.managed_bytes)

    def release_unused(self) -> None:
        """Give back the memory that the pool keeps for reuse: arrays of other sizes come next."""
        self._pool.free_held()
        return_unused_memory()  # on a CPU it is the host's

    def empty(self, shape: Sequence[int], dtype: npt.DTypeLike = np.float32) -> DeviceArray:
        """Uninitialised array.

        Raises:
            DeviceError: the device has no room for it.
        """
        dtype = np.dtype(dtype)
        nbytes = max(math.prod(map(int, shape)), 1) * dtype.itemsize
        if nbytes > self._largest_array:
            raise self._no_room(nbytes)
        try:
            return DeviceArray(self._pool.allocate(nbytes), tuple(shape), dtype)
        except (cl.Error, MemoryError) as error:
            raise self._no_room(nbytes) from error

    def empty_together(self, **shapes: tuple[int, ...] | None) -> dict[str, Any]:
        """Uninitialised arrays of float32, by name, that are handed over together; None for None.

        On a CPU they are parts of one array, so that one command hands over all.
        """
        wanted = {name: shape for name, shape in shapes.items() if shape is not None}
        if not self.cl_device.type & cl.device_type.CPU:
            return {**shapes, **{name: self.empty(shape) for name, shape in wanted.items()}}
        step = max(self.cl_device.mem_base_addr_align // 8, SHARED_ALIGNMENT)
        sizes = [round_up(4 * max(math.prod(shape), 1), step) for shape in wanted.values()]
        whole, begins = self.empty((sum(sizes),), np.uint8), accumulate(sizes, initial=0)
        pairs = zip(wanted.items(), begins, strict=False)
        return {**shapes, **{name: part_of(whole, begin, shape) for (name, shape), begin in pairs}}

    def _no_room(self, nbytes: int) -> NoRoomError:
        largest, whole = self._largest_array, self.cl_device.global_mem_size
        return NoRoomError(
            f"{self.name}: no room for an array of {nbytes / 2**20:.0f} MiB; an array may have "
            f"{largest / 2**20:.0f} MiB of {whole / 2**20:.0f}"
        )

    def zeros(self, shape: Sequence[int], dtype: npt.DTypeLike = np.float32) -> DeviceArray:
        """Array of zeros."""
        array = self.empty(shape, dtype)
        self.fill_zero(array)
        return array

    @tells_of_loss
    def fill_zero(self, array: DeviceArray, first: int = 0) -> None:
        """Overwrite an array with zero bytes, from element ``first`` on, counted flat."""
        start = first * array.dtype.itemsize
        rest = array.nbytes - start
        if rest > 0:  # some drivers fill byte by byte if the pattern is a byte
            pattern = next(size for size in (16, 4, 1) if start % size == rest % size == 0)
            zero = np.zeros(pattern, np.uint8)
            cl.enqueue_fill_buffer(self.queue, array.buffer, zero, start, rest)

    def extended(self, array: DeviceArray, rows: int) -> DeviceArray:
        """``array`` with ``rows`` rows, no fewer than it has; what the new ones hold is undefined.

        In the same memory if that has room, which it often has: the pool rounds sizes up.
        """
        longer = array.first(rows)
        if self.has_room(array, rows):
            return longer
        longer = self.empty(longer.shape, array.dtype)
        self.copy_part(array, longer, 0, array.size)
        return longer

    def has_room(self, array: DeviceArray, rows: int) -> bool:
        """Whether the memory of ``array`` holds ``rows`` rows."""
        row = math.prod(array.shape[1:]) * array.dtype.itemsize
        return rows * row <= int(array.buffer.size)

    @tells_of_loss
    def copy_part(self, source: DeviceArray, target: DeviceArray, first: int, count: int) -> None:
        """Copy elements ``first`` to ``first + count - 1``, counted flat; both of one dtype."""
        if count:
            size = source.dtype.itemsize
            cl.enqueue_copy(
                self.queue,
                target.buffer,
                source.buffer,
                byte_count=count * size,
                src_offset=first * size,
                dst_offset=first * size,
            )

    def upload(self, host: npt.NDArray[Any]) -> DeviceArray:
        """Copy of a host array on the device, same shape and dtype."""
        array = self.empty(host.shape, host.dtype)
        self.write(array, host)
        return array

    def write(self, array: DeviceArray, host: npt.NDArray[Any]) -> None:
        """Overwrite ``array`` with ``host`` (same size and dtype).

        Waits for the work before it only if ``host`` is large (transfer.WAITING_SIZE); either way,
        ``host`` may change afterwards.
        """
        if array.size != host.size or array.dtype != host.dtype:
            raise ValueError(f"cannot write {host.dtype}{host.shape} to {array.dtype}{array.shape}")
        if array.nbytes:
            self._transfers.write(array.buffer, host)

    def upload_constant(self, host: npt.NDArray[Any]) -> DeviceArray:
        """Upload without a wait, and copy once; ``host`` must never change."""
        array = self.empty(host.shape, host.dtype)
        if array.nbytes:
            self._transfers.write_constant(array.buffer, host)
        return array

    def share(self, host: npt.NDArray[Any]) -> DeviceArray:
        """A host array that the device reads, and that nobody changes as long as it does.

        On a CPU it is the host's own memory if its address is a multiple of SHARED_ALIGNMENT
        bytes; else it is copied. Keep the result until the work that reads it is finished.
        """
        address = host.__array_interface__["data"][0]
        is_cpu = bool(self.cl_device.type & cl.device_type.CPU)
        if not (is_cpu and host.size and host.flags.c_contiguous) or address % SHARED_ALIGNMENT:
            return self.upload(host)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return DeviceArray(cl.Buffer(self.context, flags, hostbuf=host), host.shape, host.dtype)

    def download(self, array: DeviceArray) -> npt.NDArray[Any]:
        """Copy of a device array on the host; waits for all work before it."""
        return self.download_later(array).get()

    def hand_over(self, array: DeviceArray) -> npt.NDArray[Any]:
        """Download an array that nothing on the device will write to any more.

        On a CPU it is not copied: the host's array is the device's memory, and keeps it.
        """
        return self.hand_over_all([array])[0]

    def hand_over_all(self, arrays: Sequence[DeviceArray]) -> list[npt.NDArray[Any]]:
        """Download several as :meth:`hand_over` does, with one wait for all."""
        return self.hand_over_later(arrays)()

    def hand_over_later(
        self, arrays: Sequence[DeviceArray]
    ) -> Callable[[], list[npt.NDArray[Any]]]:
        """Begin :meth:`hand_over_all`; the result waits, and not for later work."""
        if self.cl_device.type & cl.device_type.CPU:
            return self._transfers.hand_over(arrays)
        downloads = [self.download_later(array) for array in arrays]
        return lambda: [download.get() for download in downloads]

    @contextmanager
    def mapped(self, *arrays: DeviceArray) -> Iterator[list[npt.NDArray[Any]]]:
        """Host views of arrays, to be read within the block; waits for all work before it.

        On a CPU nothing is copied.
        """
        views = [self._transfers.map(array) for array in arrays]
        try:
            yield [view.get() for view in views]
        finally:
            for view in views:
                view.release()

    def download_later(self, array: DeviceArray) -> Download:
        """Begin a download; only ``Download.get`` waits, and not for later work."""
        return self._transfers.read(array)

    def kernel(self, program: str, name: str, **defines: int | float) -> Kernel:
        """Kernel ``name`` of ``kernels_cl/<program>.cl``; same arguments, same object.

        ``<program>_cpu.cl`` or ``<program>_gpu.cl`` if the specialisations have files of their own.

        The method's constants, the specialisation (VEC, USE_LOCAL) and the sizes of groups that
        stages share are always defined; ``defines`` adds to or overrides them. Floats become
        float32 literals.

        Raises:
            DeviceError: the program does not build on this device.
        """
        return self._programs.kernel(program, name, defines)

    def build_all(self) -> Iterator[tuple[str, list[Kernel], str]]:
        """Build all programs; yields each one's file, its kernels, and its problem or ""."""
        return self._programs.build_all()

    @tells_of_loss
    def run(
        self,
        kernel: Kernel,
        global_size: Sequence[int],
        local_size: Sequence[int] | None,
        /,
        **arguments: Argument,
    ) -> None:
        """Enqueue a kernel with its arguments, each under the name of the kernel's parameter.

        Args:
            kernel: from :meth:`kernel`.
            global_size: work-items; a multiple of ``local_size``; nothing runs if it holds a zero.
            local_size: work-items of a group; None leaves it to the driver.
            arguments: device arrays, NumPy's numbers, and vectors as arrays of their lanes.

        Raises:
            TypeError: the kernel has other arguments, or of other types.
        """
        ordered = kernel.ordered(arguments)
        if 0 in global_size:
            return
        self.launches += 1
        sizes = tuple(global_size), tuple(local_size) if local_size else None
        with kernel.lock:
            event = kernel.built(self.queue, *sizes, *ordered)
        if self._kernel_times:
            self._kernel_times.add(kernel.name, event)

    @contextmanager
    def timed_kernels(self) -> Iterator[KernelTimes]:
        """Within the block the device takes the time of every kernel."""
        usual = self.queue, self._transfers
        self.finish()
        properties = cl.command_queue_properties.PROFILING_ENABLE
        self.queue = cl.CommandQueue(self.context, properties=properties)
        self._transfers = Transfers(self.queue, self.waits, self._pinned)
        self._kernel_times = KernelTimes()
        try:
            yield self._kernel_times
        finally:
            self.finish()
            self.queue, self._transfers = usual
            self._kernel_times = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Attribute the time of the enclosed work to ``name`` while profiling is on."""
        if not self.profile.enabled:
            yield
            return
        self.finish()
        with self.profile.measure(name):
            yield
            self.finish()

    @tells_of_loss
    def flush(self) -> None:
        """Let the device begin with what is enqueued; does not wait."""
        self.queue.flush()

    @tells_of_loss
    def finish(self) -> None:
        """Wait for all enqueued work."""
        self.queue.finish()


def round_up(count: int, multiple: int) -> int:
    """The smallest multiple of ``multiple`` that is at least ``count``."""
    return -(-count // multiple) * multiple
