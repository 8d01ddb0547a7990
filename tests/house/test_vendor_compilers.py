"""What the kernels' form for GPUs takes of registers and memory, against the recorded table."""

import importlib.util
import json
from pathlib import Path

import pytest

from clgs.opencl.programs import programs_of_form, read_program
from tests.house.rules import kernels_in

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "docs" / "benchmarks" / "registers.json"
LOCAL_MEMORY = 32 * 1024
"""Bytes that every device of OpenCL 1.2 has for a work-group."""

VARIANTS_OF_VIEWS = [
    f"views_{way} {option}=1"
    for way in ("forward", "backward")
    for option in ("FISHEYE", "BY_COVARIANCE", "COMPENSATED")
]
MANY_COLORS = [
    f"channels_backward CHANNELS={options}"
    for options in ("16", "32", "32 WITH_DEPTH=1 WITH_ABSOLUTE=1")
]
TOO_FEW_REGISTERS = {
    *(
        (f"intel {chip}", name)
        for chip in ("skl", "icllp", "tgllp", "dg1", "dg2")
        for name in MANY_COLORS
    ),
    *(("intel pvc", name) for name in (*MANY_COLORS, "views_backward FISHEYE=1")),
}
"""Kernels that run 8 work-items at a time, or keep a part of their registers in memory."""


@pytest.fixture(scope="module")
def script():
    path = ROOT / "scripts" / "checks" / "vendor_compilers.py"
    spec = importlib.util.spec_from_file_location("vendor_compilers", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table():
    if not TABLE.exists():
        pytest.skip("documentation is not part of this tree")
    return json.loads(TABLE.read_text(encoding="utf-8"))


def test_the_table_has_every_vendor_and_kernels_that_exist(table):
    """A new kernel is missing until the next `vendor_compilers.sh record`, which a release asks."""
    programs = programs_of_form("gpu").values()
    kernels = {kernel for name in programs for kernel in kernels_in(read_program(name))}
    assert {target.split()[0] for target in table} == {"intel", "amd", "nvidia"}
    for target, values in table.items():
        assert not values["fails"], target
        assert {name.split()[0] for name in values["kernels"]} <= kernels, target
        assert {"channels_backward CHANNELS=16", *VARIANTS_OF_VIEWS} <= values["kernels"].keys()


def test_no_kernel_spills(table):
    """But for those of pictures of 16 colors and more on Intel's GPUs, and of a fisheye on pvc."""
    wrong = set()
    for target, values in table.items():
        for name, taken in values["kernels"].items():
            assert taken["local"] <= LOCAL_MEMORY, (target, name)
            assert taken.get("spilled", 0) == 0, (target, name)
            if taken["private"] or taken.get("simd", 16) < 16:
                wrong.add((target, name))
    assert wrong == TOO_FEW_REGISTERS


@pytest.mark.parametrize("target", ["amd gfx1030", "nvidia sm_86", "intel dg2"])
def test_kernels_take_what_is_recorded(script, table, target):
    compilers = script.Compilers(ROOT / "build" / "vendor_compilers")
    version = compilers.versions().get(target)
    if version != table[target]["compiler"]:
        pytest.skip(f"{target}: needs {table[target]['compiler']}: vendor_compilers.sh fetches it")
    found = script.measure(compilers, {target: version})
    known = table[target]["kernels"]
    found[target]["kernels"] = {k: v for k, v in found[target]["kernels"].items() if k in known}
    assert not list(script.compare(found, table))


def test_a_difference_is_named(script, table):
    (target, *_), kernels = table, dict(next(iter(table.values()))["kernels"])
    kernels["mlp_heads"] = {**kernels["mlp_heads"], "private": 1296}
    (line,) = script.compare({target: {"kernels": kernels}}, table)
    assert "mlp_heads" in line
    assert "1296" in line


@pytest.mark.parametrize("text", [None, "", '{"amd gfx900": {', "[]", "{}", '{"amd gfx900": {}}'])
def test_another_file_is_one_line(script, tmp_path, text):
    file = tmp_path / "table.json"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit, match=r"table.json: no table of registers .*record it again$"):
        script.read_table(file)
