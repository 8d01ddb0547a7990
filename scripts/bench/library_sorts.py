#!/usr/bin/env python3
"""Our sort and prefix sum beside those of pyopencl, in the form of the kernels for GPUs.

pyopencl's RadixSort and GenericScanKernel need Mako: ``pip install mako``. Keys are the bits of
random depths; a value goes with each. Rounds are interleaved, and results must be the same. Also
told: launches, as what a GPU waits for between small kernels cannot be seen on a CPU.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.algorithm
import pyopencl.array
import pyopencl.scan

from clgs.cli.options.view import positive_int
from clgs.opencl.device import Device
from clgs.ops import scan, sort

Work = Callable[[], Any]


def main() -> None:
    """Parse the arguments, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device")
    parser.add_argument("--repeats", type=positive_int, default=15)
    parser.add_argument("--counts", type=positive_int, nargs="+", default=[200_000, 1_000_000])
    args = parser.parse_args()
    device = Device(args.device, "gpu")
    print(f"{device.name}: milliseconds, median of {args.repeats}, and launches")
    for count in args.counts:
        depth = np.random.default_rng(0).uniform(0.2, 60.0, count).astype(np.float32)
        for bits in (32, 10):
            compare(
                device,
                f"sort, {count:,} keys of {bits} bits",
                args.repeats,
                sorts(device, depth, bits),
            )
        compare(device, f"prefix sum, {count:,} numbers", args.repeats, scans(device, count))


def sorts(device: Device, depth: np.ndarray, bits: int) -> list[Work]:
    """Ours and pyopencl's, of the low bits of the depths."""
    keys, values = depth.view(np.uint32), np.arange(len(depth), dtype=np.int32)
    ours = device.upload(keys), device.upload(values)
    library = pyopencl.algorithm.RadixSort(
        device.context,
        "unsigned *keys, int *values",
        key_expr="keys[i]",
        sort_arg_names=["keys", "values"],
        key_dtype=np.uint32,
    )
    theirs = [cl.array.to_device(device.queue, one) for one in (keys, values)]
    return [
        lambda: device.download(sort.by_key(device, *ours, bits)[1]),
        lambda: library(*theirs, key_bits=bits, queue=device.queue)[0][1].get(),
    ]


def scans(device: Device, count: int) -> list[Work]:
    """Ours and pyopencl's exclusive prefix sum."""
    counts = np.random.default_rng(0).integers(0, 9, count, dtype=np.int32)
    ours = device.upload(counts)
    theirs = cl.array.to_device(device.queue, counts)
    result = cl.array.empty_like(theirs)
    library = pyopencl.scan.GenericScanKernel(
        device.context,
        np.int32,
        arguments="__global int *counts, __global int *offsets",
        input_expr="counts[i]",
        scan_expr="a+b",
        neutral="0",
        output_statement="offsets[i] = prev_item;",
    )

    def scanned() -> np.ndarray:
        library(theirs, result, queue=device.queue)
        return np.asarray(result.get())

    return [lambda: device.download(scan.on_device(device, ours).offset)[:-1], scanned]


def compare(device: Device, name: str, repeats: int, work: list[Work]) -> None:
    """Print one line; the copy to the host, which both make, is in the times."""
    launches, results = [], []
    for one in work:
        with counted() as calls:
            results.append(one())
        launches.append(len(calls))
    assert np.array_equal(*results)
    times: list[list[float]] = [[], []]
    for _ in range(repeats):
        for one, found in zip(work, times, strict=True):
            device.finish()
            start = time.perf_counter()
            one()
            found.append(1e3 * (time.perf_counter() - start))
    ours, theirs = (median(one) for one in times)
    print(f"{name}: ours {ours:.2f} in {launches[0]}, pyopencl {theirs:.2f} in {launches[1]}")


@contextmanager
def counted() -> Iterator[list[None]]:
    """Everything that is called as a kernel within the block."""
    # a method of the library is replaced and put back: it has no other place to count at
    calls: list[None] = []
    usual = cl.Kernel.__call__

    def call(self: cl.Kernel, *arguments: Any, **options: Any) -> Any:
        calls.append(None)
        return usual(self, *arguments, **options)

    cl.Kernel.__call__ = call  # type: ignore[method-assign]
    try:
        yield calls
    finally:
        cl.Kernel.__call__ = usual  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
