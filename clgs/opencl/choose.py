"""List the machine's OpenCL devices, describe them, and choose one.

If there is none: drivers are not named, not loaded, or cannot start.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyopencl as cl

from clgs.errors import DeviceError, UsageError

VENDOR_FOLDER = Path("/etc/OpenCL/vendors")
"""Where files named *.icd name the drivers' libraries, on Linux (cl_khr_icd)."""

INSTALL = (
    "on Debian or Ubuntu `apt-get install pocl-opencl-icd`, elsewhere "
    '`pip install "clgs[pocl]"`, or a GPU vendor\'s driver'
)

_LOAD = "import ctypes, sys; ctypes.CDLL(sys.argv[1])"
_SECONDS = 30


@dataclass(frozen=True)
class Reason:
    """What keeps a driver from being found, and what helps."""

    problem: str
    remedy: str


@dataclass(frozen=True)
class Driver:
    """A file that names a driver: the library in it, and why it does not load; empty if it does."""

    file: str
    library: str
    problem: str


def vendor_folder() -> Path:
    """The folder of *.icd files that the loader reads."""
    named = (os.environ.get(name) for name in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH"))
    return Path(next(filter(None, named), None) or VENDOR_FOLDER)


def drivers() -> list[Driver]:
    """Every *.icd file with the library that it names, which a process of its own tries to load."""
    folder = vendor_folder()
    files = [folder] if folder.suffix == ".icd" else sorted(folder.glob("*.icd"))
    return [_driver(file) for file in files if file.is_file()]


def _driver(file: Path) -> Driver:
    try:
        library = file.read_text("utf-8", "replace").strip().splitlines()[0].strip()
    except (OSError, IndexError):
        return Driver(str(file), "", "names no library")
    command = [sys.executable, "-c", _LOAD, library]
    try:
        tried = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        return Driver(str(file), library, "takes longer than 30 s to load")
    if tried.returncode == 0:
        return Driver(str(file), library, "")
    last = (tried.stderr.strip().splitlines() or ["the process that loaded it crashed"])[-1]
    return Driver(str(file), library, last.removeprefix("OSError: "))


def pocl_cache() -> Path:
    """The folder in which PoCL keeps built kernels; without it PoCL shows no device."""
    if named := os.environ.get("POCL_CACHE_DIR"):
        return Path(named)
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "pocl" / "kcache"
    home = os.environ.get("HOME")
    return Path(home) / ".cache" / "pocl" / "kcache" if home else Path("/tmp/pocl/kcache")


def write_problem(folder: Path) -> str:
    """Why no file can be made in ``folder``, which may be missing yet; empty if one can."""
    nearest = next((one for one in (folder, *folder.absolute().parents) if one.exists()), folder)
    if not nearest.is_dir():
        return f"{nearest} is no folder"
    try:
        with tempfile.TemporaryFile(dir=nearest):
            return ""
    except OSError as error:
        return f"nothing can be written to {nearest} ({error.strerror})"


def reasons() -> list[Reason]:
    """What is wrong with this machine's drivers, whether or not there are other devices."""
    if not sys.platform.startswith("linux"):
        return []
    found, folder = drivers(), vendor_folder()
    wrong = [
        Reason(f"{one.file}: {one.library}: {one.problem}", "install that driver again")
        for one in found
        if one.problem
    ]
    if not found:
        wrong.append(Reason(f"{folder} names no driver (*.icd)", f"install one: {INSTALL}"))
    problem = write_problem(pocl_cache())
    if problem and (not found or any("pocl" in one.library for one in found)):
        problem = f"PoCL cannot keep its kernels in {pocl_cache()}: {problem}"
        wrong.append(Reason(problem, "set POCL_CACHE_DIR to a folder that can be written to"))
    return wrong


def explain() -> str:
    """Why there is no device, with remedies, in one line."""
    wrong = reasons()
    if not wrong:
        return f"install one: {INSTALL}"
    return "; ".join(f"{one.problem}: {one.remedy}" for one in wrong)


KINDS = (
    (cl.device_type.CPU, "CPU"),
    (cl.device_type.GPU, "GPU"),
    (cl.device_type.ACCELERATOR, "accelerator"),
)

LANES = ("8", "16")

FORMS = ("cpu", "gpu")
"""The forms of the kernels: vectors and no local memory, or scalars in work-groups."""

LEAST_WORK_GROUP = 256
"""Work-items of the largest work-group that is launched."""

LEAST_LOCAL_MEMORY = 32 << 10
"""Bytes per work-group, which OpenCL 1.2 asks of every device."""


def list_devices() -> list[Any]:
    """Every usable device of every platform; a platform without devices counts as none."""
    return survey()[0]


def survey() -> tuple[list[Any], list[str]]:
    """Every usable device, and a line for each platform or device that is none, with the reason."""
    devices, skipped = [], []
    try:
        platforms = cl.get_platforms()
    except cl.Error:
        platforms = []
    for platform in platforms:
        name = platform.name.strip()
        try:
            found = platform.get_devices()
        except cl.Error as error:
            skipped.append(f"platform {name}: {str(error).splitlines()[0]}")
            continue
        usable = [device for device in found if device.available and device.compiler_available]
        devices.extend(usable)
        skipped += [f"{d.name.strip()} ({name}): not usable" for d in found if d not in usable]
        if not found:
            skipped.append(f"platform {name}: no devices")
    return devices, skipped


def is_emulator(device: Any) -> bool:
    """Whether ``device`` is Oclgrind, which checks every access and is slow."""
    return "oclgrind" in device.platform.name.lower()


def is_software(device: Any) -> bool:
    """Whether ``device`` is a graphics driver's stand-in for a card, or an emulated one."""
    name = device.name.lower()
    return any(word in name for word in ("llvmpipe", "softpipe", "swrast", "fpga emulation"))


def serves_cpu_form(device: Any) -> bool:
    """Whether the kernels' form for CPUs, vectors of 16 lanes, is known to work on ``device``.

    It does with PoCL from 3.1 on and with Intel's runtime for CPUs. PoCL 3.0, the wheel on PyPI,
    hangs on the vectors or ends the process; Mesa's llvmpipe does so on a prefetch.
    """
    if not device.type & cl.device_type.CPU:
        return False
    platform = device.platform.name
    if platform == "Portable Computing Language":
        version = re.match(r"(\d+)\.(\d+)", device.driver_version)
        return version is not None and (int(version[1]), int(version[2])) >= (3, 1)
    return bool(platform.startswith("Intel")) and not is_software(device)


def wanted_form() -> str:
    """What CLGS_SPECIALISATION says, the form of the kernels; empty if it is not set.

    Raises:
        UsageError: it is neither "cpu" nor "gpu".
    """
    chosen = os.environ.get("CLGS_SPECIALISATION", "")
    if chosen and chosen not in FORMS:
        choices = " or ".join(FORMS)
        raise UsageError(f"CLGS_SPECIALISATION={chosen}: is not {choices}; correct or unset it")
    return chosen


def wanted_lanes() -> int:
    """What CLGS_LANES says; 0 if it is not set.

    Raises:
        UsageError: it is neither 8 nor 16.
    """
    chosen = os.environ.get("CLGS_LANES", "")
    if chosen and chosen not in LANES:
        raise UsageError(f"CLGS_LANES={chosen}: is not {' or '.join(LANES)}; correct or unset it")
    return int(chosen or 0)


def form_of(device: Any) -> str:
    """The form of the kernels that ``device`` runs: "cpu" or "gpu"; errors of wanted_form."""
    return wanted_form() or ("cpu" if serves_cpu_form(device) else "gpu")


def has_exact_division(device: Any) -> bool:
    """Whether ``device`` can round division and square root correctly."""
    exact: int = cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
    return bool(device.single_fp_config & exact)


def kind_of(device: Any, form: str) -> str:
    """What the bits of ``device`` depend on, with kernels of ``form``: those of a kind agree.

    That is the platform, whose driver they share, and the form. Where division is not rounded
    correctly each model divides in its own way.
    """
    division = "" if has_exact_division(device) else f", division of {device.name.strip()}"
    return f"{device.platform.name.strip()}, {form} kernels{division}"


def too_small(device: Any) -> str:
    """What ``device`` lacks to run the kernels; empty if it lacks nothing."""
    if device.max_work_group_size < LEAST_WORK_GROUP:
        most = device.max_work_group_size
        return f"its work-groups hold {most} work-items at most, {LEAST_WORK_GROUP} are needed"
    if device.local_mem_size < LEAST_LOCAL_MEMORY:
        size = device.local_mem_size
        return f"it has {size} bytes of local memory, {LEAST_LOCAL_MEMORY} are needed"
    return ""


def choose_device(name: str | None = None, flag: str = "--device") -> Any:
    """One device: by ``name``, else by PYOPENCL_CTX, else the first GPU, else the first CPU.

    A GPU with memory of its own comes before one that shares the CPU's. A card that software stands
    in for (Mesa's llvmpipe) comes after all others.

    ``name`` is the number that ``clgs devices`` shows, or a part of the device's or platform's
    name. PYOPENCL_CTX reads as in pyopencl: platform or platform:device, each a number or a part
    of a name. Emulators (Oclgrind) are taken only by name. ``flag``: the option that gave the name,
    for messages.

    Raises:
        UsageError: ``name`` is empty.
        DeviceError: there is no device, or none of that name.
    """
    if name is not None and not name.strip():
        raise UsageError(f"{flag}: the name is empty; `clgs devices` shows what there is")
    devices = list_devices()
    if not devices:
        raise DeviceError(f"no OpenCL device found; {explain()}")
    if name:
        return _pick(devices, name, f"{flag} {name}")
    if wanted := os.environ.get("PYOPENCL_CTX"):
        # the device that PYOPENCL_CTX names; a platform alone stands for its first device
        platforms = list(dict.fromkeys(device.platform for device in devices))
        first, _, second = wanted.partition(":")
        platform = _pick(platforms, first or "0", f"PYOPENCL_CTX={wanted}")
        inside = [device for device in devices if device.platform == platform]
        return _pick(inside, second or "0", f"PYOPENCL_CTX={wanted}")
    return min(devices, key=_preference)


def _pick(choices: list[Any], wanted: str, origin: str) -> Any:
    """One of ``choices`` (devices or platforms) by number or by a part of its name."""
    if wanted.isdigit():
        found = choices[int(wanted) : int(wanted) + 1]
    else:
        found = [choice for choice in choices if wanted.lower() in _full_name(choice).lower()]
    if not found:
        all_names = [choice.name.strip() for choice in choices]
        names = ", ".join(
            f"{i}: {name if all_names.count(name) == 1 else _full_name(choice)}"
            for i, (name, choice) in enumerate(zip(all_names, choices, strict=True))
        )
        raise DeviceError(f"{origin} matches no OpenCL device; available: {names}")
    return found[0]


def _full_name(choice: Any) -> str:
    platform = getattr(choice, "platform", None)
    return f"{choice.name.strip()} {platform.name}" if platform is not None else str(choice.name)


def _preference(device: Any) -> int:
    if is_emulator(device):
        return 6
    if too_small(device):
        return 5
    if is_software(device):
        return 4
    if device.type & cl.device_type.GPU:
        return 1 if device.host_unified_memory else 0
    return 2 if serves_cpu_form(device) else 3


@dataclass(frozen=True)
class DeviceInfo:
    """One device; sizes in bytes, ``vector_width`` in float32 lanes.

    kind: see :func:`kind_of`; devices of one kind may train one scene together.
    """

    index: int
    chosen: bool
    platform: str
    name: str
    type: str
    driver: str
    compute_units: int
    memory: int
    max_work_group: int
    local_memory: int
    vector_width: int
    kind: str


def describe_devices() -> list[DeviceInfo]:
    """Every usable device in the order of its index, with the one marked that clgs would choose.

    Raises:
        DeviceError: there is no device, or PYOPENCL_CTX names none.
        UsageError: as of :func:`wanted_form`.
    """
    chosen = choose_device()
    return [
        DeviceInfo(
            index=index,
            chosen=device == chosen,
            platform=device.platform.name.strip(),
            name=device.name.strip(),
            type=next((kind for bit, kind in KINDS if device.type & bit), "other"),
            driver=device.driver_version.strip(),
            compute_units=device.max_compute_units,
            memory=device.global_mem_size,
            max_work_group=device.max_work_group_size,
            local_memory=device.local_mem_size,
            vector_width=device.native_vector_width_float,
            kind=kind_of(device, form_of(device)),
        )
        for index, device in enumerate(list_devices())
    ]
