"""Why a machine shows no OpenCL device: drivers that are not named, not loaded, or cannot start."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

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
