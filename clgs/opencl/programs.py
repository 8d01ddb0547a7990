"""Build the programs of ``kernels_cl/`` for one device, each once in a process.

Their sources are read from there, and their includes expanded.
"""

from __future__ import annotations

import functools
import importlib.resources
import logging
import re
import time
import warnings
from collections.abc import Iterator
from importlib.resources.abc import Traversable

import numpy as np
import pyopencl as cl

from clgs import constants
from clgs.errors import DeviceError
from clgs.opencl.first_build import FirstBuilds
from clgs.opencl.kernel import Kernel, Parameter, signatures

_INCLUDE = re.compile(r'\s*#include\s+"(?P<name>[^"]+)"\s*')


def kernel_root() -> Traversable:
    """Folder of the shipped kernels, in a wheel and in an editable install alike."""
    return importlib.resources.files("clgs") / "kernels_cl"


def program_files() -> list[str]:
    """Files of all programs, relative to the root, such as "scan/fits.cl"."""
    folders = [entry for entry in kernel_root().iterdir() if entry.is_dir()]
    files = [f"{folder.name}/{file.name}" for folder in folders for file in folder.iterdir()]
    return sorted(name for name in files if name.endswith(".cl"))


def programs_of_form(form: str) -> dict[str, str]:
    """The names of all programs of a form ("cpu", "gpu"), each with its file."""
    other = "_gpu" if form == "cpu" else "_cpu"
    files = [name for name in program_files() if not name.endswith(f"{other}.cl")]
    return {name.removesuffix(".cl").removesuffix(f"_{form}"): name for name in files}


def program_file(program: str, form: str) -> str:
    """File of a program such as "blend/forward", relative to the root.

    ``<program>_<form>.cl`` if the forms ("cpu", "gpu") have files of their own, else
    ``<program>.cl``.
    """
    own = f"{program}_{form}.cl"
    return own if kernel_root().joinpath(*own.split("/")).is_file() else f"{program}.cl"


def read_program(name: str) -> str:
    """Source text of one program, includes expanded once, ``#line`` marks kept."""
    return _expand(name, seen=set())


def _expand(name: str, seen: set[str]) -> str:
    seen.add(name)
    out = [f'#line 1 "{name}"']
    text = kernel_root().joinpath(*name.split("/")).read_text(encoding="utf-8")
    for number, line in enumerate(text.splitlines(), start=1):
        include = _INCLUDE.fullmatch(line)
        if include is None:
            out.append(line)
            continue
        if include["name"] not in seen:
            out.append(_expand(include["name"], seen))
        out.append(f'#line {number + 1} "{name}"')
    return "\n".join(out)


BUILD_OPTIONS = ("-cl-std=CL1.2", "-cl-denorms-are-zero", "-w")
"""Subnormals cost CPUs dearly; warnings are the lint's (scripts/checks/lint_kernels.sh)."""

EXACT_DIVISION = "-cl-fp32-correctly-rounded-divide-sqrt"
"""Devices that have it get it: a GPU's usual division may be wrong in the last two bits."""

COMPILED_SECONDS = 0.06
"""Processor time above which a program was compiled, not taken from the driver's cache."""

NOTES = "clgs.notes"
"""The logger of what is good to know while one waits."""

PARTS_GROUP_SIZE = 64
"""Work-items of a group of a launch over several arrays (kernels_cl/common/parts.h)."""

SCAN_GROUP_SIZE = 256
"""Work-items of a group that scans, counts or sorts on a GPU (kernels_cl/scan/group_scan.h)."""

Defines = dict[str, int | float]
Built = tuple[cl.Program, dict[str, tuple[Parameter, ...]]]
"""A program, and the parameters of its kernels."""

_built: dict[tuple[object, ...], cl.Program] = {}
"""Programs by context, source and options: a driver takes 50 ms to bring back what it keeps."""


@functools.cache
def context_of(cl_device: cl.Device) -> cl.Context:
    """The context of a device, for all that open it: they share what is built."""
    return cl.Context([cl_device])


class Programs:
    """The programs and kernels that one device has built so far."""

    def __init__(
        self,
        context: cl.Context,
        device_name: str,
        form: str,
        lanes: int,
        exact: bool,
        prefetch: bool,
    ) -> None:
        """Nothing is built before it is asked for.

        Args:
            context: of the device.
            device_name: for messages.
            form: "cpu" or "gpu".
            lanes: VEC, unless a program defines another one.
            exact: see EXACT_DIVISION.
            prefetch: whether the driver knows the compiler's builtin; see common/prefetch.h.
        """
        self._context, self._device_name, self._form = context, device_name, form
        self._lanes, self._exact, self._prefetch = lanes, exact, prefetch
        self._kernels: dict[tuple[object, ...], Kernel] = {}
        self._programs: dict[tuple[object, ...], Built] = {}
        self._told = False
        self._first_builds = FirstBuilds(context.devices[0])

    def kernel(self, program: str, name: str, defines: Defines) -> Kernel:
        """What :meth:`clgs.opencl.device.Device.kernel` returns."""
        key = (program, name, *sorted(defines.items()))
        if key not in self._kernels:
            built, parameters = self._program(program, defines)
            self._kernels[key] = Kernel(cl.Kernel(built, name), parameters[name])
        return self._kernels[key]

    def _program(self, program: str, defines: Defines) -> Built:
        key = (program, *sorted(defines.items()))
        if key not in self._programs:
            macros = _macros(self._form, self._lanes, self._prefetch, defines)
            options, file = _options(macros, self._exact), program_file(program, self._form)
            source = read_program(file)
            built = self._build(file, source, options)
            self._programs[key] = built, signatures(source, macros)
        return self._programs[key]

    def _build(self, file: str, source: str, options: list[str]) -> cl.Program:
        seconds = self._first_builds.try_build(file, source, options)
        key = (self._context, source, *options)
        if key not in _built:
            start = time.thread_time()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", cl.CompilerWarning)
                    _built[key] = cl.Program(self._context, source).build(options)
            except cl.RuntimeError as error:
                # the first line of a build log that names a source line, else its last line
                log = str(error)
                lines = [line.strip() for line in log.splitlines() if line.strip()]
                marked = [line for line in lines if re.search(r"\.(cl|h):\d+", line)]
                errors = [line for line in marked if "error" in line]
                raise DeviceError(
                    f"kernels_cl/{file} does not build on {self._device_name}: "
                    f"{(errors or marked or lines[-1:] or ['no build log'])[0]}"
                ) from error
            seconds += time.thread_time() - start
        if seconds > COMPILED_SECONDS and not self._told:
            self._told = True  # the next start of the process need not compile
            logging.getLogger(NOTES).info("compiling kernels for %s (once)", self._device_name)
        return _built[key]

    def build_all(self) -> Iterator[tuple[str, list[Kernel], str]]:
        """Build every program of the form, with the usual sizes.

        Yields:
            The program's file, its kernels, and what is wrong if it does not build.
        """
        for program, file in programs_of_form(self._form).items():
            try:
                _, parameters = self._program(program, {})
                yield file, [self.kernel(program, name, {}) for name in parameters], ""
            except (DeviceError, cl.Error) as error:
                yield file, [], str(error)


def build_options(form: str, exact: bool, own: Defines | None = None) -> list[str]:
    """Options of programs of scalars, without prefetch; ``own``: defines of the program."""
    return _options(_macros(form, 1, False, own or {}), exact)


def _macros(form: str, lanes: int, prefetch: bool, own: Defines) -> dict[str, str]:
    """The values of all macros; ``own``: of one program, come before the device's."""
    defines = {
        **constants.defines(),
        "PARTS_GROUP_SIZE": PARTS_GROUP_SIZE,
        "SCAN_GROUP_SIZE": SCAN_GROUP_SIZE,
        "USE_LOCAL": int(form == "gpu"),
        "USE_PREFETCH": int(prefetch),
        "VEC": lanes,
        **own,
    }
    return {name: literal(value) for name, value in defines.items()}


def _options(macros: dict[str, str], exact: bool) -> list[str]:
    values = [f"-D{name}={value}" for name, value in sorted(macros.items())]
    return [*BUILD_OPTIONS, *([EXACT_DIVISION] if exact else []), *values]


def literal(value: int | float) -> str:
    """A number as OpenCL C has it: an int, or a float32 of the same bits."""
    if isinstance(value, int):
        return str(value)
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
