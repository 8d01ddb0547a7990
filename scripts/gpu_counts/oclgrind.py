"""Build the plugin, and run a command under Oclgrind with it.

Needs Debian's packages ``oclgrind liboclgrind-dev llvm-14-dev opencl-c-headers g++``.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from subprocess import run

HERE = Path(__file__).resolve().parent
LIBRARIES = (Path("/usr/lib"), Path("/usr/local/lib"))
HEADERS = ("/usr/include", "/usr/local/include")
LLVM = "/usr/lib/llvm-14/include"
"""Oclgrind 21.10 is built with LLVM 14: the plugin must be, too."""

OPTIMISED = "-O3"
"""What a GPU's compiler does at least: loops of a known length are unrolled."""


def missing() -> list[str]:
    """What the plugin lacks to be built and used here; empty if nothing."""
    lacks = [] if shutil.which("g++") else ["g++"]
    if not any(Path(folder, "oclgrind/Plugin.h").exists() for folder in HEADERS):
        lacks.append("liboclgrind-dev")
    if not any(Path(folder, "CL/cl.h").exists() for folder in HEADERS):
        lacks.append("opencl-c-headers")
    if not Path(LLVM, "llvm/IR/Instruction.h").exists():
        lacks.append("llvm-14-dev")
    if runtime() is None:
        lacks.append("oclgrind")
    return lacks


def runtime() -> Path | None:
    """Oclgrind's driver."""
    found = [path for folder in LIBRARIES for path in folder.rglob("liboclgrind-rt-icd.so")]
    return found[0] if found else None


def build(folder: Path) -> Path:
    """The plugin, compiled into ``folder``.

    Raises:
        CalledProcessError: it does not compile.
    """
    plugin = folder / "gpu_counts.so"
    options = ["-std=c++17", "-O2", "-fPIC", "-shared", "-fno-rtti", "-w"]
    include = [f"-I{folder}" for folder in (LLVM, *HEADERS[1:])]
    source = str(HERE / "plugin" / "plugin.cpp")
    libraries = ["-loclgrind", "-lLLVM-14"]
    run(["g++", *options, *include, "-o", str(plugin), source, *libraries], check=True)
    return plugin


def environment(folder: Path, plugin: Path, counts: Path) -> dict[str, str]:
    """Variables with which a process finds Oclgrind alone and appends its counts to ``counts``."""
    vendors = folder / "vendors"
    vendors.mkdir(exist_ok=True)
    (vendors / "oclgrind.icd").write_text(f"{runtime()}\n", encoding="utf-8")
    usual = {name: value for name, value in os.environ.items() if name != "PYOPENCL_CTX"}
    return {
        **usual,
        "CLGS_GPU_COUNTS": str(counts),
        "OCL_ICD_VENDORS": str(vendors),
        "OCLGRIND_BUILD_OPTIONS": OPTIMISED,
        "OCLGRIND_PLUGINS": str(plugin),
        "PYOPENCL_NO_CACHE": "1",
    }
