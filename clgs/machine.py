"""Facts about this machine in plain data: processor, system, versions, free memory."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path

from clgs import __version__

LIBRARIES = ("numpy", "pyopencl")


def host_facts() -> dict[str, object]:
    """The processor's name, the operating system, and versions; no host names and no times."""
    versions = {name: metadata.version(name) for name in LIBRARIES}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.processor(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "versions": {"clgs": __version__, "python": platform.python_version(), **versions},
    }


def available_memory() -> int | None:
    """Bytes that programs can have without swapping; None if the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return None
    sizes = (line.split() for line in lines if line.startswith("MemAvailable:"))
    return next((int(words[1]) << 10 for words in sizes), None)
