"""Instructions of NVIDIA's sm_90 that every kernel is compiled to, by class.

Static: each counts once, however often it runs. Needs ptxas and nvdisasm, of the Python packages
``nvidia-cuda-nvcc-cu12`` and ``nvidia-cuda-nvdisasm`` or on the PATH.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import sysconfig
import tempfile
from pathlib import Path
from subprocess import run
from typing import Any

CLASSES = {
    "fused multiply-add": ("FFMA",),
    "other float": ("FADD", "FMUL", "FSEL", "FSETP", "FMNMX", "FCHK"),
    "special function": ("MUFU",),
    "global load": ("LDG", "LD"),
    "global store": ("STG", "ST"),
    "shared load": ("LDS",),
    "shared store": ("STS",),
    "spill": ("LDL", "STL"),
    "atomic": ("ATOM", "ATOMG", "ATOMS", "RED"),
    "barrier": ("BAR",),
    "branch": ("BRA", "BRX", "BSSY", "BSYNC", "BREAK", "CALL", "RET", "EXIT", "WARPSYNC"),
}
OTHER = "integer and other"
PADDING = "NOP"
INSTRUCTION = re.compile(
    r"^\s+/\*[0-9a-f]{4,}\*/\s+(?:@!?U?P[0-9T]+ +)?([A-Z][A-Z0-9]*)", re.MULTILINE
)


def registers() -> Any:
    """The script that knows the compilers, scripts/checks/kernel_registers.py."""
    path = Path(__file__).resolve().parents[1] / "checks" / "kernel_registers.py"
    spec = importlib.util.spec_from_file_location("kernel_registers", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def find_nvdisasm() -> str | None:
    """On the PATH, or in the packages of this Python."""
    inside = Path(sysconfig.get_path("purelib"), "nvidia").rglob("bin/nvdisasm")
    return shutil.which("nvdisasm") or next(map(str, inside), None)


def instructions(source: Path) -> dict[str, dict[str, int]]:
    """Classes of instructions by kernel of the checkout; empty without the compilers."""
    compilers, nvdisasm = registers(), find_nvdisasm()
    if nvdisasm is None or compilers.TARGETS[1] not in compilers.find_compilers():
        return {}
    compilers.KERNELS = source / "kernels_cl"
    programs = sorted(p for p in compilers.KERNELS.glob("*/*.cl") if not p.stem.endswith("_cpu"))
    found: dict[str, dict[str, int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for program in programs:
            found |= by_kernel(disassembled(compilers, nvdisasm, program, Path(folder)))
    return found


def disassembled(compilers: Any, nvdisasm: str, program: Path, folder: Path) -> str:
    """The machine's code of one program."""
    ptx, cubin = folder / "program.ptx", folder / "program.cubin"
    flags = ["-target", "nvptx64--nvidiacl", "-march=sm_75"]
    library = compilers.linked("nvptx64--nvidiacl.bc")
    ptx.write_text(compilers.compiled(program, [*flags, *library]), encoding="utf-8")
    compilers.output([compilers.find_ptxas(), "-arch=sm_90", "-o", str(cubin), str(ptx)])
    return run([nvdisasm, "-c", str(cubin)], capture_output=True, text=True, check=True).stdout


def by_kernel(text: str) -> dict[str, dict[str, int]]:
    """Classes of instructions from nvdisasm's listing."""
    found = {}
    for part in re.split(r"^\.text\.", text, flags=re.MULTILINE)[1:]:
        counts = dict.fromkeys([*CLASSES, OTHER], 0)
        for name in INSTRUCTION.findall(part):
            if name != PADDING:
                counts[next((c for c, names in CLASSES.items() if name in names), OTHER)] += 1
        found[part[: part.index(":")]] = {**counts, "all": sum(counts.values())}
    return found
