"""The machine under examination: devices, drivers, memory, disk, optional packages."""

from __future__ import annotations

import importlib.util
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clgs.doctor import ERROR, NOTE, WARNING, Finding, errors_first
from clgs.errors import ClgsError, UsageError
from clgs.machine import available_memory, host_facts
from clgs.poses.pycolmap_child import import_problem

if TYPE_CHECKING:
    from clgs.opencl.device import Device

COUNT = 1000
"""Numbers that each check computes with."""

MAX_BITS_ERROR = 1e-6
"""Largest relative error of estimated bits, as in ``clgs selftest``."""

LEAST_MEMORY = 2 << 30
LEAST_DISK = 1 << 30

OPTIONAL = {
    "pycolmap": ("clgs prepare", "pip install pycolmap"),
    "cv2": ("clgs prepare", "pip install opencv-python-headless"),
    "pillow_heif": ("HEIC photos", 'pip install "clgs[heif]"'),
    "imageio_ffmpeg": ("videos", 'pip install "clgs[video]"'),
}
"""Per module: what needs it, and the command that installs it."""


@dataclass(frozen=True)
class Tried:
    """A device that passed its checks: their number, and the largest error divided by its limit."""

    index: int
    name: str
    checks: int
    worst: float
    seconds: float


@dataclass(frozen=True)
class ExaminedMachine:
    """Facts of the machine, the devices that passed, and all findings, errors first."""

    facts: dict[str, str]
    devices: list[Tried]
    findings: list[Finding]


def examine_machine() -> ExaminedMachine:
    """Everything that clgs needs of this machine; builds all programs for each device."""
    findings = [*_memory_and_disk(), *_packages()]
    devices: list[Tried] = []
    try:
        for found in _devices():
            if isinstance(found, Finding):
                findings.append(found)
            else:
                devices.append(found)
    except ImportError as error:
        problem = f"pyopencl cannot be loaded ({error})"
        findings.append(Finding(ERROR, "OpenCL", problem, "pip install pyopencl"))
    host, available, here = host_facts(), available_memory(), Path.cwd()
    versions = host["versions"]
    assert isinstance(versions, dict)
    facts = {
        "system": str(host["system"]),
        "processor": f"{host['processor']}, {os.cpu_count()} threads",
        "memory": "unknown" if available is None else f"{available / 2**30:.1f} GiB available",
        "disk": f"{shutil.disk_usage(here).free / 2**30:.1f} GiB free in {here}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
    }
    return ExaminedMachine(facts, devices, errors_first(findings))


def _memory_and_disk() -> Iterator[Finding]:
    from clgs.opencl.choose import write_problem

    available = available_memory()
    if available is not None and available < LEAST_MEMORY:
        problem = f"{available / 2**30:.1f} GiB of memory are available"
        remedy = "end other programs, or train with --photo-memory 256 and a larger --downscale"
        yield Finding(WARNING, "memory", problem, remedy)
    folders = {"disk": Path.cwd()}
    try:
        folders["temporary files"] = Path(tempfile.gettempdir())
    except FileNotFoundError:
        remedy = "set TMPDIR to a folder that can be written to"
        problem = "there is no folder for temporary files"
        yield Finding(ERROR, "temporary files", problem, remedy)
    for name, folder in folders.items():
        free = shutil.disk_usage(folder).free
        if free < LEAST_DISK:
            problem = f"{free / 2**30:.2f} GiB are free in {folder}"
            yield Finding(WARNING, name, problem, "free some space; a run takes about 1 GiB")
        if problem := write_problem(folder):
            yield Finding(WARNING, name, problem, "run clgs in a folder of yours")


def _packages() -> Iterator[Finding]:
    for module, (use, remedy) in OPTIONAL.items():
        if importlib.util.find_spec(module) is None:
            yield Finding(NOTE, module, f"is not installed; it is needed for {use}", remedy)
        elif problem := import_problem(module):
            again = remedy.replace("install", "install --force-reinstall")
            problem = f"cannot be loaded ({problem}); it is needed for {use}"
            yield Finding(WARNING, module, problem, again)


def _devices() -> Iterator[Tried | Finding]:
    """Each device that passes its checks, and everything that is wrong with the others."""
    from clgs.opencl.choose import INSTALL, is_emulator, reasons, survey

    devices, skipped = survey()
    wrong = reasons()
    for one in wrong:
        yield Finding(WARNING if devices else ERROR, "OpenCL", one.problem, one.remedy)
    for line in skipped if devices else ():
        remedy = "install its driver again, or leave it"
        yield Finding(NOTE, "OpenCL", f"left out: {line}", remedy)
    if not devices and not wrong:
        yield Finding(ERROR, "OpenCL", "there is no device", f"install one: {INSTALL}")
    for index, device in enumerate(devices):
        if is_emulator(device):
            name = f"{index}: {device.name.strip()}"
            yield Finding(NOTE, name, "an emulator, not tried", "clgs selftest takes minutes on it")
        else:
            yield _try(index)


def _try(index: int) -> Tried | Finding:
    """The device after its checks, once all programs are built, or what is wrong with it."""
    from clgs.opencl.device import Device

    start, name, found = time.perf_counter(), str(index), []
    try:
        device = Device(str(index))
        name = f"{index}: {device.name}"
        for _, _, problem in device.build_all():
            if problem:
                return Finding(ERROR, name, problem, "update its driver, or use another --device")
        for stage, error, limit in device_errors(device):
            found.append(error / limit if limit else error)
            if not error <= limit:
                problem = f"{stage}: error {error:.1e}, at most {limit:.0e}"
                remedy = "do not use it; update its driver, then run clgs selftest"
                return Finding(ERROR, name, problem, remedy)
    except UsageError as error:  # a variable of the environment
        problem, _, remedy = str(error).rpartition("; ")
        return Finding(ERROR, name, problem, remedy)
    except ClgsError as error:
        return Finding(ERROR, name, str(error), "update its driver, or use another --device")
    except Exception as error:  # a driver may raise anything
        problem = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return Finding(ERROR, name, problem, "update its driver, or use another --device")
    return Tried(index, device.name, len(found), max(found), time.perf_counter() - start)


def device_errors(device: Device) -> Iterator[tuple[str, float, float]]:
    """(stage, error, limit) of a few short stages, compared with NumPy in float64.

    ``clgs selftest`` compares all stages, which takes longer.
    """
    from clgs.ops import quantize, rate, scan, sort
    from clgs.reference import quantize as quantize_reference
    from clgs.reference import rate as rate_reference

    rng = np.random.default_rng(5)
    counts = rng.integers(0, 50, COUNT).astype(np.int32)
    offsets, total = scan.exclusive(device, device.upload(counts))
    wanted = np.cumsum(counts, dtype=np.int64)
    wrong = np.abs(device.download(offsets) - (wanted - counts)).max() + abs(total - wanted[-1])
    yield "scan", float(wrong), 0.0
    keys = rng.integers(0, 2**32, COUNT).astype(np.uint32)
    keys[::3] = keys[0]
    values = np.arange(COUNT, dtype=np.int32)
    _, order = sort.by_key(device, device.upload(keys), device.upload(values), 32)
    wrong = np.abs(device.download(order) - np.argsort(keys, kind="stable")).max()
    yield "sort", float(wrong), 0.0
    x = rng.laplace(0.3, np.arange(1, 7), (COUNT // 6, 6)).astype(np.float32)
    uploaded = device.upload(x)
    rounded = device.download(quantize.forward(device, [(uploaded, 8.0)])[0])
    yield "quantize", float(np.abs(rounded - quantize_reference.forward(x, 8.0)).max()), 0.0
    bits = rate_reference.forward(rate_reference.symbols(x, 1.0), "pooled")
    error = abs(rate.forward(device, uploaded, 1.0, "pooled").bits - bits) / bits
    yield "rate", float(error), MAX_BITS_ERROR
