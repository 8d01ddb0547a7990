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

from clgs.data.native.probe import import_problem
from clgs.doctor.finding import ERROR, NOTE, WARNING, Finding
from clgs.errors import ClgsError, UsageError

SECONDS = 1.0
"""After so long no further check of a device is begun; building kernels counts."""

COUNT = 1000
"""Numbers that each check computes with."""

LEAST_MEMORY = 2 << 30
LEAST_DISK = 1 << 30

OPTIONAL = {
    "pycolmap": ("clgs prepare and COLMAP models", "pip install pycolmap"),
    "pillow_heif": ("HEIC photos", 'pip install "clgs[heif]"'),
    "imageio_ffmpeg": ("videos", 'pip install "clgs[video]"'),
}
"""By module: what needs it, and how to get it."""


@dataclass(frozen=True)
class Tried:
    """A device after its checks: how many ran, and how near the worst came to its limit."""

    index: int
    name: str
    checks: int
    worst: float
    seconds: float


@dataclass(frozen=True)
class ExaminedMachine:
    """What it has, the devices that were tried, and all findings."""

    facts: dict[str, str]
    devices: list[Tried]
    findings: list[Finding]

    @property
    def usable(self) -> bool:
        """Whether a device computed what it should."""
        return bool(self.devices)


def examine_machine() -> ExaminedMachine:
    """Everything that clgs needs of this machine, with a second of checks of each device."""
    findings = [*_memory(), *_disk(), *_packages()]
    devices: list[Tried] = []
    try:
        devices = list(_devices(findings))
    except ImportError as error:
        problem = f"pyopencl cannot be loaded ({error})"
        findings.append(Finding(ERROR, "OpenCL", problem, "pip install pyopencl"))
    order = (ERROR, WARNING, NOTE)
    findings.sort(key=lambda finding: order.index(finding.level))
    return ExaminedMachine(_facts(), devices, findings)


def _facts() -> dict[str, str]:
    from clgs.lab.facts import host_facts

    host = host_facts()
    versions = host["versions"]
    assert isinstance(versions, dict)
    free = shutil.disk_usage(Path.cwd()).free
    available = available_memory()
    return {
        "system": str(host["system"]),
        "processor": f"{host['processor']}, {os.cpu_count()} threads",
        "memory": "unknown" if available is None else f"{available / 2**30:.1f} GiB available",
        "disk": f"{free / 2**30:.1f} GiB free in {Path.cwd()}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
    }


def available_memory() -> int | None:
    """Bytes that programs can have without swapping; None if the system does not tell."""
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return None
    sizes = (line.split() for line in lines if line.startswith("MemAvailable:"))
    return next((int(words[1]) << 10 for words in sizes), None)


def _memory() -> Iterator[Finding]:
    available = available_memory()
    if available is not None and available < LEAST_MEMORY:
        problem = f"{available / 2**30:.1f} GiB of memory are available"
        remedy = "end other programs, or train with --photo-memory 256 and a larger --downscale"
        yield Finding(WARNING, "memory", problem, remedy)


def _disk() -> Iterator[Finding]:
    from clgs.opencl.absence import write_problem

    for name, folder in (("disk", Path.cwd()), ("temporary files", _temporary_folder())):
        if folder is None:
            remedy = "set TMPDIR to a folder that can be written to"
            yield Finding(ERROR, name, "there is no folder for temporary files", remedy)
            continue
        free = shutil.disk_usage(folder).free
        if free < LEAST_DISK:
            problem = f"{free / 2**30:.2f} GiB are free in {folder}"
            yield Finding(WARNING, name, problem, "free some space; a run takes about 1 GiB")
        if problem := write_problem(folder):
            yield Finding(WARNING, name, problem, "run clgs in a folder of yours")


def _temporary_folder() -> Path | None:
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError:
        return None


def _packages() -> Iterator[Finding]:
    for module, (use, remedy) in OPTIONAL.items():
        if importlib.util.find_spec(module) is None:
            yield Finding(NOTE, module, f"is not installed; {use} need it", remedy)
        elif problem := import_problem(module):
            again = remedy.replace("install", "install --force-reinstall")
            yield Finding(WARNING, module, f"cannot be loaded ({problem}); {use} need it", again)


def _devices(findings: list[Finding]) -> Iterator[Tried]:
    """Each device that passes its checks; what is wrong is added to ``findings``."""
    from clgs.opencl.absence import INSTALL, reasons
    from clgs.opencl.choose import is_emulator, survey

    devices, skipped = survey()
    level = WARNING if devices else ERROR
    wrong = reasons()
    findings += [Finding(level, "OpenCL", one.problem, one.remedy) for one in wrong]
    for line in skipped if devices else ():
        remedy = "install its driver again, or leave it"
        findings.append(Finding(NOTE, "OpenCL", f"left out: {line}", remedy))
    if not devices and not wrong:
        findings.append(Finding(ERROR, "OpenCL", "there is no device", f"install one: {INSTALL}"))
    for index, device in enumerate(devices):
        if is_emulator(device):
            name = f"{index}: {device.name.strip()}"
            remedy = "clgs selftest --device takes minutes on it"
            findings.append(Finding(NOTE, name, "an emulator, not tried", remedy))
            continue
        tried = _try(index)
        if isinstance(tried, Finding):
            findings.append(tried)
        else:
            yield tried


def _try(index: int) -> Tried | Finding:
    """A second of checks of one device, and what is wrong with it."""
    from clgs.lab.selftest.training_checks import training_checks
    from clgs.opencl.device import Device

    start, worst, count, name = time.perf_counter(), 0.0, 0, str(index)
    try:
        device = Device(str(index))
        name = f"{index}: {device.name}"
        for stage, quantity, error, limit, _ in training_checks(device, COUNT):
            count += 1
            if not error <= limit:
                problem = f"{stage} {quantity}: error {error:.1e}, at most {limit:.0e}"
                remedy = "do not use it; update its driver, then run clgs selftest"
                return Finding(ERROR, name, problem, remedy)
            worst = max(worst, error / limit if limit else 0.0)
            if time.perf_counter() - start > SECONDS:
                break
    except UsageError as error:  # a variable of the environment
        problem, _, remedy = str(error).rpartition("; ")
        return Finding(ERROR, name, problem, remedy)
    except ClgsError as error:
        return Finding(ERROR, name, str(error), "update its driver, or use another --device")
    except Exception as error:  # a driver raises whatever it chooses
        problem = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return Finding(ERROR, name, problem, "update its driver, or use another --device")
    return Tried(index, device.name, count, worst, time.perf_counter() - start)
