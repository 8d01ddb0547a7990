"""What the kernels' form for GPUs takes of registers and memory, against the recorded table."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from clgs.opencl.source import program_files, read_program
from tests.house.rules import kernels_in

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "docs" / "benchmarks" / "registers.json"
LOCAL_MEMORY = 32 * 1024
"""Bytes that every device of OpenCL 1.2 has for a work-group."""


@pytest.fixture(scope="module")
def script() -> Any:
    path = ROOT / "scripts" / "checks" / "kernel_registers.py"
    spec = importlib.util.spec_from_file_location("kernel_registers", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table() -> Any:
    if not TABLE.exists():
        pytest.skip("documentation is not part of this tree")
    return json.loads(TABLE.read_text(encoding="utf-8"))


def test_the_table_has_every_kernel_and_registers_suffice(table):
    programs = [name for name in program_files() if not name.endswith("_cpu.cl")]
    kernels = {kernel for name in programs for kernel in kernels_in(read_program(name))}
    for target in table.values():
        assert target["kernels"].keys() == kernels
        for values in target["kernels"].values():
            assert values["spilled"] == 0
            assert values["private"] <= 32
            assert values["local"] <= LOCAL_MEMORY


@pytest.mark.parametrize("target", ["amd gfx900", "nvidia sm_90"])
def test_kernels_take_what_is_recorded(script, table, target):
    compilers = script.find_compilers()
    if compilers.get(target) != table[target]["compiler"]:
        pytest.skip(f"{target}: recorded by {table[target]['compiler']}, which is not here")
    found = script.measure({target: compilers[target]})
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
