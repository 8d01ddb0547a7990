#!/usr/bin/env python3
"""What the compilers of GPU vendors make of every kernel of the form for GPUs; no card is needed.

    scripts/checks/vendor_compilers.sh [record|check]

is how to call it: the script fetches the compilers. Each program is compiled with the product's own
source and options by Intel's ocloc, by clang with ROCm's device libraries for AMD, and to PTX by
clang with libclc, of which ptxas makes code for NVIDIA. ``check`` compares with the targets of
docs/benchmarks/registers.json whose compiler is here in the same version, and says what it leaves
out. Both also build all programs with NEO, Intel's driver, which starts without hardware in a mode
that records commands and computes nothing. Exit code 1 if a kernel differs, or NEO fails.

For each kernel: ``registers`` of a work-item (Intel: of a hardware thread); ``spilled`` and
``scalars_spilled``: registers that had to go to memory (AMD) or bytes of them (NVIDIA);
``private``: bytes of memory for a work-item (Intel: for a hardware thread), spills included;
``local``: bytes for a work-group; ``simd``: Intel's work-items per hardware thread. The key
``fails`` lists the programs on which the compiler fails. A kernel as other than usual options make
it has its defines after its name.
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
from typing import Any

from clgs.opencl.programs import Defines, build_options, programs_of_form, read_program
from clgs.ops.general.channels import CHUNK, FEW_REGISTERS_CHUNK
from clgs.ops.mlp import FEW_REGISTERS

INTEL = ("skl", "icllp", "tgllp", "dg1", "dg2", "pvc")
NO_EXACT_DIVISION = ("tgllp", "dg1")
AMD = ("gfx803", "gfx906", "gfx90a", "gfx942", "gfx1010", "gfx1030", "gfx1100", "gfx1201")
NVIDIA = ("sm_61", "sm_75", "sm_86", "sm_89", "sm_90", "sm_120")
CLANGS = ("clang-15", "clang-19", "clang-18", "clang-17", "clang-16", "clang")
NEO = ("skl", "tgllp", "dg2")
ISA_VERSIONS = {"gfx942": 9402, "gfx1100": 11000, "gfx1201": 12001}
"""Chips that are newer than ROCm's libraries of Debian 12. A number is all that these must know of
a chip. Newer libraries are bitcode that clang 15 cannot read."""

ISA_VERSION = (
    "@__oclc_ISA_version = linkonce_odr protected local_unnamed_addr addrspace(4) constant i32 {}\n"
)

NEWER_THAN_CLANG_15 = ("gfx942", "gfx1201")
LIBCLC = tuple(map(Path, ("/usr/lib/clc", "/usr/share/clc", "/usr/local/share/clc")))

PICTURES: tuple[dict[str, int | float], ...] = (
    *({"CHANNELS": colors} for colors in (8, FEW_REGISTERS_CHUNK, CHUNK)),
    {"CHANNELS": CHUNK, "WITH_DEPTH": 1, "WITH_ABSOLUTE": 1},
)
VARIANTS: dict[str, tuple[dict[str, int | float], ...]] = {
    **dict.fromkeys(("channels/forward", "channels/backward", "channels/sums"), PICTURES),
    "views/views": ({"FISHEYE": 1}, {"BY_COVARIANCE": 1}, {"COMPENSATED": 1}),
}
"""Defines of programs that options of users change."""

Resources = dict[str, int]
Table = dict[str, dict[str, Any]]


class Compilers:
    """The compilers that are here, and what each makes of a program."""

    def __init__(self, folder: Path) -> None:
        """``folder``: where vendor_compilers.sh unpacked packages."""
        self.folder = folder
        self.libraries = next(folder.glob("usr/lib/*-linux-gnu"), folder)
        self.ocloc = folder / "usr" / "bin" / "ocloc"
        self.clang = next(filter(None, map(shutil.which, CLANGS)), None)
        self.libclc = next((f for f in LIBCLC if (f / "nvptx64--nvidiacl.bc").exists()), None)
        inside = Path(sysconfig.get_path("purelib")) / "nvidia" / "cuda_nvcc" / "bin" / "ptxas"
        places = (str(inside), *map(str, folder.glob("python/nvidia/cuda_nvcc/bin/ptxas")), "ptxas")
        self.ptxas = next(filter(None, map(shutil.which, places)), None)
        self.newer_libraries = {"LD_LIBRARY_PATH": str(self.libraries)}

    def versions(self) -> dict[str, str]:
        """Targets that can be compiled for, and the versions of what compiles."""
        found: dict[str, str] = {}
        if self.ocloc.exists():
            versions = f"IGC {self._package('libigc1')}, ocloc {self._package('intel-opencl-icd')}"
            found |= {f"intel {target}": versions for target in INTEL}
        if self.clang is None:
            return found
        version = "clang " + _run([self.clang, "-dumpversion"]).strip()
        bitcode = self.libraries / "amdgcn" / "bitcode"
        for target in AMD if bitcode.is_dir() else ():
            command = self._clang_for(target)
            if command is None:
                continue
            library = bitcode / f"oclc_isa_version_{target[3:]}.bc"
            if not library.exists():
                flags = ["-target", "amdgcn-amd-amdhsa", "-nogpulib", "-w", "-emit-llvm"]
                text = ISA_VERSION.format(ISA_VERSIONS[target])
                given = [*command, *flags, "-x", "ir", "-c", "-", "-o", str(library)]
                _run(given, self.newer_libraries, given=text)
            compiler = "clang " + _run([*command, "-dumpversion"], self.newer_libraries).strip()
            libraries = f"device libraries {self._package('rocm-device-libs')}"
            found[f"amd {target}"] = f"{compiler}, {libraries}"
        if self.ptxas and self.libclc:
            release = re.search(r"V([\d.]+)", _run([self.ptxas, "--version"]))
            assert release is not None
            found |= {f"nvidia {t}": f"{version}, ptxas {release[1]}" for t in NVIDIA}
        return found

    def _clang_for(self, chip: str) -> list[str] | None:
        """The clang that knows an AMD chip, if it is here."""
        if chip not in NEWER_THAN_CLANG_15:
            return [str(self.clang)]
        newer = self.folder / "usr" / "lib" / "llvm-19" / "bin" / "clang"
        return [str(newer)] if newer.exists() else None

    def _package(self, name: str) -> str:
        """The version of a Debian package, from the name of its file."""
        return next(self.folder.glob(f"packages/{name}_*.deb")).name.split("_")[1]

    def resources(self, target: str, source: Path, own: Defines) -> dict[str, Resources] | None:
        """Per kernel of a program, with defines of its ``own``, what it takes.

        None if the compiler fails.
        """
        vendor, chip = target.split()
        with tempfile.TemporaryDirectory() as folder:
            try:
                compile_for = {"intel": self._intel, "amd": self._amd, "nvidia": self._nvidia}
                return compile_for[vendor](chip, source, Path(folder), own)
            except subprocess.SubprocessError:
                return None

    def _intel(self, chip: str, source: Path, folder: Path, own: Defines) -> dict[str, Resources]:
        exact = chip not in NO_EXACT_DIVISION
        options = " ".join(build_options("gpu", exact, {**FEW_REGISTERS, **own}))
        command = [str(self.ocloc), "compile", "-file", str(source), "-device", chip]
        command += ["-options", options, "-internal_options", "-cl-intel-allow-zebin"]
        _run([*command, "-out_dir", str(folder)], {"LD_LIBRARY_PATH": str(self.libraries)})
        (binary,) = folder.glob("*.bin")
        text = binary.read_bytes().partition(b"\nkernels:")[2].partition(b"\0")[0].decode()
        found = {}
        for kernel in re.split(r"^  - name: +", text, flags=re.M)[1:]:
            name, buffers = kernel.split()[0], re.findall(r"usage: +\w+\n +size: +(\d+)", kernel)
            if name.startswith("Intel_Symbol_Table") or "simd_size" not in kernel:
                continue
            found[name] = {
                "registers": _number(r"grf_count: +(\d+)", kernel),
                "private": sum(map(int, buffers)),
                "local": _number(r"slm_size: +(\d+)", kernel),
                "simd": _number(r"simd_size: +(\d+)", kernel),
            }
        return found

    def _amd(self, chip: str, source: Path, folder: Path, own: Defines) -> dict[str, Resources]:
        libraries = self.libraries / "amdgcn" / "bitcode"
        flags = ["-target", "amdgcn-amd-amdhsa", f"-mcpu={chip}"]
        flags.append(f"--rocm-device-lib-path={libraries}")
        text = self._clang(self._clang_for(chip) or [], flags, source, folder, own)
        fields = {
            "registers": "vgpr_count",
            "spilled": "vgpr_spill_count",
            "scalars_spilled": "sgpr_spill_count",
            "private": "private_segment_fixed_size",
            "local": "group_segment_fixed_size",
        }
        kernels = re.split(r"^  - \.", text[text.index("amdhsa.kernels:") :], flags=re.M)[1:]
        return {
            re.findall(r"^    \.name: +(\w+)$", kernel, re.M)[-1]: {
                key: _number(rf"\.{field}: +(\d+)", kernel) for key, field in fields.items()
            }
            for kernel in kernels
        }

    def _nvidia(self, chip: str, source: Path, folder: Path, own: Defines) -> dict[str, Resources]:
        library = ["-Xclang", "-mlink-builtin-bitcode", "-Xclang"]
        library.append(f"{self.libclc}/nvptx64--nvidiacl.bc")
        march = min(chip, "sm_75", key=lambda name: int(name[3:]))
        flags = ["-target", "nvptx64--nvidiacl", f"-march={march}"]
        self._clang([str(self.clang)], [*flags, *library], source, folder, own)
        code = str(folder / "code.cubin")
        said = _run([str(self.ptxas), "-v", f"-arch={chip}", "-o", code, str(folder / "code.s")])
        return {
            part[: part.index("'")]: {
                "registers": _number(r"Used (\d+) registers", part),
                "spilled": _number(r"(\d+) bytes spill stores", part),
                "private": _number(r"(\d+) bytes stack frame", part),
                "local": _number(r"(\d+) bytes smem", part),
            }
            for part in said.split("Compiling entry function '")[1:]
        }

    def _clang(
        self, clang: list[str], flags: list[str], source: Path, folder: Path, own: Defines
    ) -> str:
        """The assembly of one program, which also lies in ``code.s``."""
        code = folder / "code.s"
        command = [*clang, "-x", "cl", "-O3", "-S", "-Wno-linker-warnings", *flags]
        options = build_options("gpu", True, own)
        _run([*command, *options, "-o", str(code), str(source)], self.newer_libraries)
        return code.read_text(encoding="utf-8")


def main() -> int:
    """Parse the arguments, compile, record or compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("record", "check"))
    parser.add_argument("file", type=Path)
    parser.add_argument("folder", type=Path, help="where vendor_compilers.sh unpacked packages")
    args = parser.parse_args()
    compilers = Compilers(args.folder)
    versions = compilers.versions()
    if args.action == "record":
        vendors = {target.split()[0] for target in versions}
        if lacking := {"intel", "amd", "nvidia"} - vendors:
            print(f"vendor_compilers: no compiler for {', '.join(lacking)}", file=sys.stderr)
            return 1
        text = json.dumps(measure(compilers, versions), indent=1, sort_keys=True)
        short = re.sub(r"\{\s+(\"\w+\": \d+,?\s+)+\}", lambda m: " ".join(m[0].split()), text)
        args.file.write_text(short + "\n", encoding="utf-8")
        print("\n".join(wrong := list(neo_problems(compilers))) or "vendor_compilers: recorded")
        return 1 if wrong else 0
    known = read_table(args.file)
    usable = {t: v for t, v in versions.items() if t in known and known[t]["compiler"] == v}
    for target in sorted(known.keys() - usable.keys()):
        print(f"vendor_compilers: skipped {target}: needs {known[target]['compiler']}")
    wrong = [*compare(measure(compilers, usable), known), *neo_problems(compilers)]
    print("\n".join(wrong) or f"vendor_compilers: {len(usable)} targets as recorded")
    return 1 if wrong else 0


def read_table(file: Path) -> Table:
    """What ``record`` wrote; ends the program if it is something else."""
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        if not table or any(not {"compiler", "kernels"} <= t.keys() for t in table.values()):
            raise ValueError("a target lacks its compiler or its kernels")
    except (OSError, ValueError, TypeError, AttributeError) as error:
        sys.exit(f"vendor_compilers: {file}: no table of registers ({error}); record it again")
    return dict(table)


def measure(compilers: Compilers, versions: dict[str, str]) -> Table:
    """What all kernels take, by target."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        sources = {}
        for program, file in programs_of_form("gpu").items():
            sources[program] = Path(folder, file.replace("/", "_"))
            sources[program].write_text(read_program(file), encoding="utf-8")
        table: Table = {}
        for target, version in versions.items():
            jobs = list(jobs_of(target))
            every = pool.map(
                lambda job, t=target: compilers.resources(t, sources[job[0]], job[1]), jobs
            )
            kernels, fails = {}, []
            for (program, own), found in zip(jobs, every, strict=True):
                options = "".join(f" {name}={value}" for name, value in own.items())
                kernels |= {name + options: value for name, value in (found or {}).items()}
                fails += [program + options] if found is None else []
            table[target] = {"compiler": version, "kernels": kernels, "fails": fails}
    return table


def jobs_of(target: str) -> Iterator[tuple[str, Defines]]:
    """The programs that a target runs, with defines of their own."""
    for program in programs_of_form("gpu"):
        for own in ({}, *VARIANTS.get(program, ())):
            few = target.startswith("intel") and program == "channels/forward"
            if not few or own.get("CHANNELS", 0) <= FEW_REGISTERS_CHUNK:
                yield program, own


def compare(found: Table, known: Table) -> Iterator[str]:
    """A line for each kernel that takes something else than recorded, is new, or is gone."""
    for target, values in found.items():
        for program in values.get("fails", []):
            yield f"{target}: the compiler fails on {program}"
        new, old = values["kernels"], known[target]["kernels"]
        for name in sorted(new.keys() | old.keys()):
            if new.get(name) != old.get(name):
                yield f"{target}: {name} takes {new.get(name)}, recorded is {old.get(name)}"


def neo_problems(compilers: Compilers) -> Iterator[str]:
    """Build all programs with NEO for each of its targets; a line for each problem."""
    library = compilers.libraries / "intel-opencl" / "libigdrcl.so"
    if not library.exists():
        print("vendor_compilers: skipped NEO: it is not here")
        return
    for target in NEO:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "intel.icd").write_text(f"{library.resolve()}\n", encoding="utf-8")
            environment = {
                **{"OCL_ICD_VENDORS": folder, "XDG_CACHE_HOME": folder, "CLGS_CACHE": folder},
                "LD_LIBRARY_PATH": str(compilers.libraries.resolve()),
                **{"NEOReadDebugKeys": "1", "SetCommandStreamReceiver": "1"},
                "ProductFamilyOverride": target,
            }
            try:
                printed = _run([sys.executable, "-c", BUILD_ALL], environment, folder)
                print(f"vendor_compilers: NEO {target}: {printed.strip()}")
            except subprocess.CalledProcessError as error:
                said = (error.stderr.strip().splitlines() or ["it says nothing"])[-1]
                yield f"NEO {target}: exit code {error.returncode}: {said}"


BUILD_ALL = """
import pyopencl as cl
from clgs.opencl.choose import LEAST_WORK_GROUP, list_devices
from clgs.opencl.programs import Programs

(device,) = list_devices()
if not device.platform.name.startswith("Intel"):
    raise SystemExit("this is not NEO but " + device.platform.name)
exact = bool(device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT)
built = Programs(cl.Context([device]), device.name, "gpu", 1, exact, False)
limit, count = cl.kernel_work_group_info.WORK_GROUP_SIZE, 0
for file, kernels, problem in built.build_all():
    if problem:
        raise SystemExit(problem)
    for kernel in kernels:
        count += 1
        most = kernel.built.get_work_group_info(limit, device)
        # NEO does not know its limits if it does not know the chip's number, as of dg2.
        if device.max_work_group_size and most < LEAST_WORK_GROUP:
            raise SystemExit(f"{kernel.name}: work-groups of {most} at most")
print(f"{count} kernels built")
"""


def _number(pattern: str, text: str) -> int:
    found = re.search(pattern, text)
    return int(found[1]) if found else 0


def _run(
    command: list[str],
    environment: dict[str, str] | None = None,
    folder: str | None = None,
    given: str = "",
) -> str:
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
        cwd=folder,
        input=given,
        env={**os.environ, **(environment or {})},
    )
    return done.stdout + done.stderr


if __name__ == "__main__":
    sys.exit(main())
