#!/usr/bin/env python3
"""Registers, spills and memory of every kernel's form for GPUs, compiled for two real targets.

    scripts/checks/kernel_registers.py record FILE
    scripts/checks/kernel_registers.py check FILE

clang and libclc compile each program for AMD's gfx900, whose assembly tells what a kernel takes,
and to PTX, which ptxas turns into code for NVIDIA's sm_90. ptxas is looked for on the PATH and
among the Python packages (``pip install nvidia-cuda-nvcc-cu12``). ``check`` compares with the
targets of FILE that can be compiled here by the same version, and says what it leaves out. Exit
code 1 if a kernel differs.

Of each kernel: ``registers`` of a work-item; ``spilled``, how many of them had to go to memory
(AMD) or how many bytes (NVIDIA); ``private``, bytes of memory of a work-item, spills included;
``local``, bytes of a work-group.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KERNELS = ROOT / "kernels_cl"
FORM = ["-DVEC=1", "-DUSE_LOCAL=1"]
LIBCLC = [Path(p) for p in ("/usr/lib/clc", "/usr/share/clc", "/usr/local/share/clc")]
TARGETS = ("amd gfx900", "nvidia sm_90")
CLANGS = ("clang-15", "clang", "clang-14", "clang-16", "clang-17", "clang-18", "clang-19")

Resources = dict[str, int]


def main() -> int:
    """Parse the arguments, compile, record or compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("record", "check"))
    parser.add_argument("file", type=Path)
    args = parser.parse_args()
    compilers = find_compilers()
    if args.action == "record":
        lacking = [target for target in TARGETS if target not in compilers]
        if lacking:
            print(f"kernel_registers: no compiler for {', '.join(lacking)}", file=sys.stderr)
            return 1
        text = json.dumps(measure(compilers), indent=1, sort_keys=True)
        args.file.write_text(text + "\n", encoding="utf-8")
        return 0
    known = read_table(args.file)
    usable = {t: v for t, v in compilers.items() if known[t]["compiler"] == v}
    for target in sorted(known.keys() - usable.keys()):
        print(f"kernel_registers: skipped {target}: needs {known[target]['compiler']}")
    differences = list(compare(measure(usable), known))
    print(
        "\n".join(differences) or f"kernel_registers: {', '.join(usable) or 'nothing'} as recorded"
    )
    return 1 if differences else 0


def read_table(file: Path) -> dict[str, dict[str, object]]:
    """What ``record`` wrote; ends the program if it is something else."""
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        if any(not {"compiler", "kernels"} <= table[target].keys() for target in TARGETS):
            raise ValueError("a target lacks its compiler or its kernels")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        sys.exit(f"kernel_registers: {file}: no table of registers ({error}); record it again")
    return dict(table)


def find_compilers() -> dict[str, str]:
    """Targets that can be compiled for, and the versions of what compiles."""
    clang, libclc, ptxas = find_clang(), find_libclc(), find_ptxas()
    if clang is None or libclc is None:
        return {}
    version = "clang " + output([clang, "-dumpversion"]).strip()
    found = {TARGETS[0]: version}
    if ptxas:
        release = re.search(r"release [\d.]+, V([\d.]+)", output([ptxas, "--version"]))
        found[TARGETS[1]] = f"{version}, ptxas {release[1] if release else 'unknown'}"
    return found


def measure(compilers: dict[str, str]) -> dict[str, dict[str, object]]:
    """What all kernels take, by target."""
    programs = sorted(p for p in KERNELS.glob("*/*.cl") if not p.stem.endswith("_cpu"))
    result: dict[str, dict[str, object]] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for target, version in compilers.items():
            one = amd_resources if target == TARGETS[0] else nvidia_resources
            kernels = {k: v for found in pool.map(one, programs) for k, v in found.items()}
            result[target] = {"compiler": version, "kernels": kernels}
    return result


def compare(
    found: dict[str, dict[str, object]], known: dict[str, dict[str, object]]
) -> Iterator[str]:
    """A line for each kernel that takes something else than recorded, is new, or is gone."""
    for target, values in found.items():
        new, old = values["kernels"], known[target]["kernels"]
        assert isinstance(new, dict)
        assert isinstance(old, dict)
        for name in sorted(new.keys() | old.keys()):
            if new.get(name) != old.get(name):
                yield f"{target}: {name} takes {new.get(name)}, recorded is {old.get(name)}"


def amd_resources(program: Path) -> dict[str, Resources]:
    """Figures of each kernel, from the metadata of the assembly."""
    flags = ["-target", "amdgcn-amd-amdhsa", "-mcpu=gfx900", "-nogpulib", "-Wno-linker-warnings"]
    text = compiled(program, [*flags, *linked("amdgcn--amdhsa.bc")])
    metadata = text[text.index("amdhsa.kernels:") :]
    numbers = {
        "registers": "vgpr_count",
        "spilled": "vgpr_spill_count",
        "private": "private_segment_fixed_size",
        "local": "group_segment_fixed_size",
    }
    found = {}
    for kernel in re.split(r"^  - \.args:", metadata, flags=re.M)[1:]:
        name = re.search(r"^    \.name: +(\w+)$", kernel, re.M)
        assert name is not None
        values = {key: re.search(rf"\.{field}: +(\d+)", kernel) for key, field in numbers.items()}
        found[name[1]] = {key: int(value[1]) for key, value in values.items() if value}
    return found


def nvidia_resources(program: Path) -> dict[str, Resources]:
    """Figures of each kernel, from what ptxas says of the code that it makes."""
    flags = ["-target", "nvptx64--nvidiacl", "-march=sm_75"]
    ptxas = find_ptxas()
    assert ptxas is not None
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "program.ptx"
        text = compiled(program, [*flags, *linked("nvptx64--nvidiacl.bc")])
        source.write_text(text, encoding="utf-8")
        command = [ptxas, "-v", "-arch=sm_90", "-o", str(source.with_suffix(".cubin")), str(source)]
        said = output(command)
    found = {}
    for part in said.split("Compiling entry function '")[1:]:
        registers = re.search(r"Used (\d+) registers", part)
        private = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores", part)
        shared = re.search(r"(\d+) bytes smem", part)
        assert registers
        assert private
        found[part[: part.index("'")]] = {
            "registers": int(registers[1]),
            "spilled": int(private[2]),
            "private": int(private[1]),
            "local": int(shared[1]) if shared else 0,
        }
    return found


def compiled(program: Path, flags: list[str]) -> str:
    """The assembly of one program in its form for GPUs."""
    clang = find_clang()
    assert clang is not None
    options = ["-x", "cl", "-cl-std=CL1.2", "-I", str(KERNELS), "-O3", "-w", "-S", "-o", "-"]
    return output([clang, *options, *flags, *FORM, str(program)])


def linked(library: str) -> list[str]:
    """Options of clang that link a file of libclc."""
    folder = find_libclc()
    return ["-Xclang", "-mlink-builtin-bitcode", "-Xclang", f"{folder}/{library}"]


def find_clang() -> str | None:
    """The program that ``lint_kernels.sh`` finds."""
    return next((found for name in CLANGS if (found := shutil.which(name))), None)


def find_libclc() -> Path | None:
    """The folder of libclc with both targets."""
    files = ("nvptx64--nvidiacl.bc", "amdgcn--amdhsa.bc")
    return next((f for f in LIBCLC if all((f / name).exists() for name in files)), None)


def find_ptxas() -> str | None:
    """On the PATH, or in the packages of this Python."""
    inside = Path(sysconfig.get_path("purelib")) / "nvidia" / "cuda_nvcc" / "bin" / "ptxas"
    return shutil.which("ptxas") or (str(inside) if os.access(inside, os.X_OK) else None)


def output(command: list[str]) -> str:
    """What a command prints; ends the program if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"kernel_registers: {' '.join(command)} failed:\n{done.stderr}")
    return done.stdout + done.stderr if "ptxas" in command[0] else done.stdout


if __name__ == "__main__":
    sys.exit(main())
