"""Python and the kernels agree on every constant that both type.

Python's is passed to the build. The headers' default lets each file compile alone.
"""

import ast
import importlib
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clgs import constants
from clgs.opencl.kernel import preprocess
from clgs.opencl.programs import kernel_root, program_file, program_files, read_program
from clgs.options import PARITY, Skips
from tests.house.rules import op_paths

ROOT = Path(__file__).resolve().parents[2]
FORMS = {"cpu": {"VEC": "16", "USE_LOCAL": "0"}, "gpu": {"VEC": "1", "USE_LOCAL": "1"}}
MODULES = ["opencl/programs", "lab/kernels"]
MODULES += [f"ops/{path}" for path in op_paths(ROOT).values()]

VARYING = {
    *("VEC", "USE_LOCAL", "USE_PREFETCH"),  # the form, and the driver
    *("WIDTH", "COEFFICIENTS", "MIN_EXTENT", "BY_WEIGHTS"),  # of arrays and calls
    *("CHANNELS", "WITH_DEPTH", "WITH_ABSOLUTE", "SH_ROWS", "BARE_SUMS"),
    *("PARALLEL_RAYS", "FISHEYE", "BY_COVARIANCE", "COMPENSATED"),
    "TILES_AT_ONCE",  # of the width of registers
    "ROWS",  # the same
    *("SSIM_C1", "SSIM_C2", *(f"SSIM_WEIGHT_{tap}" for tap in range(6)), "SKIP_FLAT"),
    *("PREFETCH", "PREFETCH_WRITE", "OUTPUT_SPACE"),  # of the compiler, and of a file
}
"""Options of the kernels that are no constant of a module."""


def options(text: str) -> set[str]:
    """The macros of a kernel source that a build may define."""
    blocks = re.findall(r"^#ifndef \w+\n((?:#define \w+\b.*\n)+)#endif", text, re.M)
    return {name for block in blocks for name in re.findall(r"#define (\w+)", block)}


def number(text: str) -> np.float32:
    """The value of a default such as "1e-4f" or "(64)"."""
    return np.float32(text.strip("() ").removesuffix("f"))


def defaults(program: str, form: str) -> dict[str, str]:
    """The macros of a program that is built alone."""
    found = preprocess(read_program(program_file(program, form)), FORMS[form])[1]
    chosen = {name: body for name, (parameters, body) in found.items() if parameters is None}
    pattern = re.compile(r"\(USE_LOCAL \? (\d+) : (\d+)\)")
    return {name: pattern.sub(r"\1" if form == "gpu" else r"\2", chosen[name]) for name in chosen}


def module_constants(module: str) -> dict[str, Any]:
    """The numbers that a module of clgs names, also those with one value per form."""
    tree = ast.parse((ROOT / f"clgs/{module}.py").read_text(encoding="utf-8"))
    assigned = [node.targets for node in tree.body if isinstance(node, ast.Assign)]
    names = re.findall(r"\b[A-Z][A-Z0-9_]+\b", " ".join(ast.unparse(one) for [one] in assigned))
    loaded = importlib.import_module(f"clgs.{module.replace('/', '.')}")
    found = {name: getattr(loaded, name) for name in names}
    return {
        name: value
        for name, value in found.items()
        if isinstance(value, int | float)
        or (isinstance(value, dict) and value.keys() == FORMS.keys())
    }


def programs_of(text: str) -> set[str]:
    """The programs that a module fetches."""
    names = {re.sub(r"(_cpu|_gpu)?\.cl$", "", file) for file in program_files()}
    return {name for name in re.findall(r'"(\w+/\w+)"', text) if name in names}


def shared() -> dict[str, int | float]:
    """What every kernel, or every kernel that decides about alpha, gets."""
    skips = Skips().defines(*(field.name for field in fields(Skips)))
    return {**constants.defines(), **PARITY.defines(), **skips}


def complaints(module: str, form: str) -> Iterator[str]:
    """Constants of a module that its kernels define by another value, or do not get from it."""
    source = (ROOT / f"clgs/{module}.py").read_text(encoding="utf-8")
    every = {re.sub(r"(_cpu|_gpu)?\.cl$", "", file) for file in program_files()}
    for program in sorted(programs_of(source) or every):
        macros, text = defaults(program, form), read_program(program_file(program, form))
        for name, value in module_constants(module).items():
            if name not in macros:
                continue
            wanted = value[form] if isinstance(value, dict) else value
            if number(macros[name]) != np.float32(wanted):
                yield f"{program}: {name} is {macros[name]}, in Python {wanted}"
            if name not in options(text):
                yield f"{program}: {name} has no #ifndef"
            if not re.search(rf'"{name}":|\b{name}=', source):
                yield f"clgs/{module}.py does not pass {name}"


@pytest.mark.parametrize("form", FORMS)
def test_defaults_are_the_constants_of_python(form):
    assert not [line for module in MODULES for line in complaints(module, form)]


@pytest.mark.parametrize("form", FORMS)
def test_defaults_are_the_constants_of_the_method(form):
    expected = shared()
    for program in sorted({re.sub(r"(_cpu|_gpu)?\.cl$", "", file) for file in program_files()}):
        macros = defaults(program, form)
        for name in expected.keys() & macros.keys():
            assert number(macros[name]) == np.float32(expected[name]), (program, name)


def test_every_option_is_a_constant_of_python():
    rooms = [room for room in kernel_root().iterdir() if room.is_dir()]
    files = [file for room in rooms for file in Path(str(room)).rglob("*.[ch]*")]
    found = set().union(*(options(file.read_text(encoding="utf-8")) for file in files))
    known = {name for module in MODULES for name in module_constants(module)}
    assert found - known - set(shared()) == VARYING
