"""Every kernel file builds: alone with its form's defaults, and in both specialisations."""

from __future__ import annotations

import re

import pyopencl as cl
import pytest

from clgs.opencl.source import kernel_root, program_files, read_program
from tests.house.rules import kernels_in, plain_c

PROGRAMS = program_files()
NOT_PORTABLE = re.compile(
    r"\b(?:native_\w+|half_(?:cos|divide|exp\w*|log\w*|powr|recip|rsqrt|sin|sqrt|tan)\b"
    r"|(?:half|double)\d*\b|atom_\w+|sub_group_\w+|work_group_\w+"
    r"|(?:mad|exp|exp2|log|log2|pow|rsqrt|sin|cos)\s*\()"
)


def build(device, name, text):
    form = ["-DVEC=1", "-DUSE_LOCAL=1"] if name.endswith("_gpu.cl") else []
    return cl.Program(device.context, text).build(options=["-cl-std=CL1.2", *form])


@pytest.mark.parametrize("name", PROGRAMS)
def test_builds_alone_with_its_defaults(open_device, name):
    text = read_program(name)
    built = build(open_device("cpu"), name, text)
    assert set(built.kernel_names.split(";")) <= set(kernels_in(text))


@pytest.mark.parametrize("name", PROGRAMS)
def test_builds_in_its_specialisations(device, name):
    program = name.removesuffix(".cl").removesuffix(f"_{device.specialisation}")
    if program.endswith(("_cpu", "_gpu")):
        pytest.skip("the file of the other specialisation")
    kernels = kernels_in(read_program(name))
    assert kernels
    for kernel in kernels:
        limit = device.kernel(program, kernel).built.get_work_group_info(
            cl.kernel_work_group_info.LOCAL_MEM_SIZE, device.cl_device
        )
        assert limit <= 32 * 1024, f"{kernel} uses {limit} bytes of local memory"


@pytest.mark.parametrize("name", PROGRAMS[::5])
def test_errors_name_file_and_line(open_device, name):
    text = read_program(name) + "\nint broken = undeclared_name;\n"
    line = (
        len(kernel_root().joinpath(*name.split("/")).read_text(encoding="utf-8").splitlines()) + 1
    )
    with pytest.raises(cl.RuntimeError, match=rf"{name}:{line}"):
        build(open_device("cpu"), name, text)


@pytest.mark.parametrize("name", PROGRAMS)
def test_stays_within_the_portable_subset(name):
    found = NOT_PORTABLE.findall(plain_c(read_program(name)))
    assert not found, "neither portable nor the same on every device"
