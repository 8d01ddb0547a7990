"""Generated mutants: every rule finds its kind of bug, and nothing but code is changed."""

import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "scripts" / "checks"
sys.path.insert(0, str(FOLDER))
try:
    import mutants
    import mutation_check
finally:
    sys.path.remove(str(FOLDER))


def changed(text, python=False):
    """Rule and new line of every change of a line."""
    changes = mutants.python_changes(text) if python else mutants.c_changes(text)
    return [(rule, (text[:start] + new + text[end:]).strip()) for rule, start, end, new in changes]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("x = a + b;", [("swap", "x = a - b;"), ("statement", ";")]),
        ("const int *x = a;", []),
        ("y = fmin(a, 0.5f);", [
            ("swap", "y = fmax(a, 0.5f);"), ("constant", "y = fmin(a, 1.0f);"), ("statement", ";"),
        ]),
        ("sum[i] += -v;", [
            ("index", "sum[i + 1] += -v;"), ("sign", "sum[i] += v;"), ("statement", ";"),
            ("swap", "sum[i] -= -v;"),
        ]),
        ("if (i < n)", [("swap", "if (i <= n)"), ("guard", "if (1)"), ("guard", "if (0)")]),
        ("barrier(CLK_LOCAL_MEM_FENCE);", [("statement", ";")]),
        ("/* a + b; */", []),
        ("#define X (a + 1)", []),
    ],
)  # fmt: skip
def test_rules_of_c(line, expected):
    assert sorted(changed(f"    {line}\n")) == sorted(expected)


def test_rules_of_python():
    line = "size: int | None = max(n - 1, count // 2)  # 3 < 4\n"
    assert changed(line, python=True) == [
        ("swap", "size: int | None = max(n + 1, count // 2)  # 3 < 4"),
        ("constant", "size: int | None = max(n - 2, count // 2)  # 3 < 4"),
        ("swap", "size: int | None = max(n - 1, count * 2)  # 3 < 4"),
        ("constant", "size: int | None = max(n - 1, count // 3)  # 3 < 4"),
    ]


@pytest.fixture(scope="module")
def every():
    return mutants.all_mutants()


def test_every_stage_has_mutants_and_tests(every):
    assert {stage for one in every for stage in one.stages} == set(mutants.STAGES)
    assert len({one.number for one in every}) == len(every) > 1000
    for stage in mutants.STAGES:
        assert all((mutants.ROOT / file).exists() for file in mutation_check.suite(stage))


def test_the_choice_changes_with_the_lines_that_change(every):
    stages = ["adam", "blend"]
    chosen = mutation_check.drawn(every, stages, 5, 0)
    assert mutation_check.drawn(every, stages, 5, 0) == chosen
    assert mutation_check.drawn(every, stages, 5, 1) != chosen
    assert len(chosen) == 10
    assert len({one.rule for one in chosen[5:]}) >= 4
    fewer = [one for one in every if one.number != chosen[0].number]
    again = mutation_check.drawn(fewer, stages, 5, 0)
    assert len({one.number for one in again} & {one.number for one in chosen}) >= 7


def test_a_form_is_known_by_its_file(every):
    forms = {one.file: one.form for one in every}
    assert forms["kernels_cl/blend/forward_gpu.cl"] == "gpu"
    assert forms["kernels_cl/blend/forward_cpu.cl"] == "cpu"
    assert forms["kernels_cl/blend/rays.h"] == ""
