"""Kernel sources: found as package data, includes expanded once, lines marked."""

from __future__ import annotations

import pytest

from clgs.opencl import programs


@pytest.fixture
def kernels(monkeypatch, tmp_path):
    """A folder that stands for kernels_cl."""
    (tmp_path / "include").mkdir()
    monkeypatch.setattr(programs, "kernel_root", lambda: tmp_path)
    return tmp_path


def test_the_kernels_are_shipped():
    names = {entry.name for entry in programs.kernel_root().iterdir()}
    assert {"common", "blend", "mlp"} <= names
    assert "blend/prepare.cl" in programs.program_files()


def test_includes_are_expanded_with_line_marks(kernels):
    (kernels / "include" / "a.h").write_text("int a;\n")
    (kernels / "x.cl").write_text('int before;\n#include "include/a.h"\nint after;\n')
    assert programs.read_program("x.cl").splitlines() == [
        '#line 1 "x.cl"',
        "int before;",
        '#line 1 "include/a.h"',
        "int a;",
        '#line 3 "x.cl"',
        "int after;",
    ]


def test_a_header_is_expanded_once(kernels):
    (kernels / "include" / "a.h").write_text("int a;\n")
    (kernels / "include" / "b.h").write_text('#include "include/a.h"\nint b;\n')
    (kernels / "x.cl").write_text('#include "include/a.h"\n#include "include/b.h"\n')
    text = programs.read_program("x.cl")
    assert text.count("int a;") == 1
    assert text.index("int a;") < text.index("int b;")


def test_headers_that_include_each_other_end(kernels):
    (kernels / "include" / "a.h").write_text('#include "include/b.h"\nint a;\n')
    (kernels / "include" / "b.h").write_text('#include "include/a.h"\nint b;\n')
    (kernels / "x.cl").write_text('#include "include/a.h"\n')
    assert programs.read_program("x.cl").count("int ") == 2


def test_a_missing_program_is_an_error(kernels):
    with pytest.raises(FileNotFoundError):
        programs.read_program("missing.cl")


def test_a_form_with_a_file_of_its_own_is_preferred(kernels):
    for name in ("shared.cl", "own_cpu.cl", "own_gpu.cl"):
        (kernels / "include" / name).write_text("")
    assert programs.program_file("include/shared", "cpu") == "include/shared.cl"
    assert programs.program_file("include/own", "cpu") == "include/own_cpu.cl"
    assert programs.program_file("include/own", "gpu") == "include/own_gpu.cl"
