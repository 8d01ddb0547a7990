"""Every kernel file builds: alone with its form's defaults, and in both specialisations."""

import math
import re

import numpy as np
import pyopencl as cl
import pytest

from clgs.opencl.choose import LEAST_LOCAL_MEMORY, LEAST_WORK_GROUP
from clgs.opencl.kernel import DTYPES, signatures
from clgs.opencl.programs import kernel_root, program_files, read_program
from tests.house.rules import kernels_in, plain_c

PROGRAMS = program_files()
NOT_PORTABLE = re.compile(
    r"//|\bbarrier\((?!CLK_LOCAL_MEM_FENCE\))"
    r"|\b(?:atomic_(?:cmp)?xchg\b|native_\w+"
    r"|half_(?:cos|divide|exp\w*|log\w*|powr|recip|rsqrt|sin|sqrt|tan)\b"
    r"|(?:half|double)\d*\b|atom_\w+|sub_group_\w+|work_group_\w+"
    r"|(?:mad|exp|exp2|log|log2|pow|rsqrt|sin|cos)\s*\()"
)


FORMS = [
    (name, form)
    for name in PROGRAMS
    for form in ("cpu", "gpu")
    if not name.endswith({"cpu": "_gpu.cl", "gpu": "_cpu.cl"}[form])
]
SPACES = {"": "PRIVATE"}
TYPES = {np.dtype(dtype): name for name, dtype in DTYPES.items()}


def build(device, form, text):
    options = ["-DVEC=1", "-DUSE_LOCAL=1"] if form == "gpu" else []
    return cl.Program(device.context, text).build(
        options=["-cl-std=CL1.2", "-cl-kernel-arg-info", *options]
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form"), FORMS)
def test_builds_alone_with_its_defaults(open_device, name, form):
    """And the driver finds the parameters that clgs reads from the source."""
    text = read_program(name)
    built = build(open_device("cpu"), form, text)
    found = signatures(text, {"VEC": "1", "USE_LOCAL": "1"} if form == "gpu" else {})
    assert set(built.kernel_names.split(";")) == found.keys() == set(kernels_in(text))
    for kernel in built.all_kernels():
        parameters = found[kernel.function_name]
        assert kernel.num_args == len(parameters)
        assert [described(kernel, i) for i in range(kernel.num_args)] == [
            (
                one.name,
                f"{TYPES[one.dtype]}{one.lanes if one.lanes > 1 else ''}{'*' if one.space else ''}",
                SPACES.get(one.space, one.space.upper()),
            )
            for one in parameters
        ]


def described(kernel, i: int) -> tuple[str, str, str]:
    """What the driver says of a parameter: name, type, address space."""
    info, spaces = cl.kernel_arg_info, cl.kernel_arg_address_qualifier
    space = kernel.get_arg_info(i, info.ADDRESS_QUALIFIER)
    return (
        kernel.get_arg_info(i, info.NAME).removeprefix("_cl_"),  # PoCL renames its own functions
        kernel.get_arg_info(i, info.TYPE_NAME),
        spaces.to_string(space),
    )


@pytest.mark.parametrize("name", PROGRAMS)
def test_builds_in_its_specialisations(device, name):
    program = name.removesuffix(".cl").removesuffix(f"_{device.specialisation}")
    if program.endswith(("_cpu", "_gpu")):
        pytest.skip("the file of the other specialisation")
    kernels = kernels_in(read_program(name))
    assert kernels
    asked = cl.kernel_work_group_info
    for kernel in kernels:
        built = device.kernel(program, kernel)
        taken = built.built.get_work_group_info(asked.LOCAL_MEM_SIZE, device.cl_device)
        assert taken <= LEAST_LOCAL_MEMORY, f"{kernel} uses {taken} bytes of local memory"
        items = built.built.get_work_group_info(asked.COMPILE_WORK_GROUP_SIZE, device.cl_device)
        assert math.prod(items) <= LEAST_WORK_GROUP, f"{kernel} has work-groups of {items}"
        assert all(one.lanes != 3 for one in built.parameters), "vectors of 3 take room for 4"


@pytest.mark.parametrize("name", PROGRAMS[::5])
def test_errors_name_file_and_line(open_device, name):
    text = read_program(name) + "\nint broken = undeclared_name;\n"
    line = (
        len(kernel_root().joinpath(*name.split("/")).read_text(encoding="utf-8").splitlines()) + 1
    )
    with pytest.raises(cl.RuntimeError, match=rf"{name}:{line}"):
        build(open_device("cpu"), "gpu" if name.endswith("_gpu.cl") else "cpu", text)


@pytest.mark.parametrize("name", PROGRAMS)
def test_stays_within_the_portable_subset(name):
    found = NOT_PORTABLE.findall(plain_c(read_program(name)))
    assert not found, "neither portable nor the same on every device"
