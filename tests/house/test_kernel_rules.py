"""The rules for kernel files complain about what they should, and about nothing else."""

import pytest

from tests.house import kernel_rules

HEADER = """/* unused() and Nothing are only spoken of here */
#ifndef CLGS_A_H
#define CLGS_A_H
#define LIMIT 3
typedef struct {
    int x, y;
} Point;
typedef float real;
#define DEFINE_TWICE(name) \\
    static inline int name(int x) { return 2 * x; }
DEFINE_TWICE(twice)
static inline __attribute__((always_inline)) const Point *
pick(const Point *p)
{
    return p;
}
#endif
"""
KERNEL = "__kernel void room_verb(__global int *x) { x[0] = %s; }\n"


def test_the_names_that_a_header_defines_are_found():
    names = kernel_rules.defined_names(HEADER)
    assert names == {"LIMIT", "Point", "real", "DEFINE_TWICE", "twice", "pick"}


def test_members_comments_and_includes_are_no_uses():
    text = '#include "twice.h"\n/* LIMIT */ int f = p.pick + q->real;\n'
    assert kernel_rules.used_names(text) == {"int", "f", "p", "q"}


@pytest.mark.parametrize(
    "text",
    [
        "inline int f(int x) { return x; }",
        "int f(int x) { return x; }",
        "static int f(int x) { return x; }",
        "inline __attribute__((always_inline)) int f(int x) { return x; }",
        "#define DEFINE_F(name) \\\n    inline int name(int x) { return x; }",
    ],
)
def test_helpers_that_are_not_static_inline_are_found(text):
    assert kernel_rules.inline_complaints("room/a.h", text)


@pytest.mark.parametrize(
    "text",
    [
        HEADER,
        KERNEL % "inline_me(1)",
        "__attribute__((reqd_work_group_size(1, 1, 1))) " + KERNEL % "1",
        "GROUP __kernel void room_verb(__global int *x) { if (x[0]) { x[0] = 1; } }",
        "/* an inline function */ __constant int table[] = {1, 2};",
    ],
)
def test_kernels_and_static_inline_helpers_pass(text):
    assert kernel_rules.inline_complaints("room/a.cl", text) == []


@pytest.mark.parametrize("before", ["", "for (int j = 0; j < 2; ++j)\n"])
def test_barriers_in_unrolled_loops_are_found(before):
    loop = "for (int i = 0; i < 2; ++i) {\n    x[i] = 1; /* } */\n    barrier(F);\n}\n"
    (found,) = kernel_rules.unroll_complaints("room/a.h", f"#pragma unroll\n{before}{loop}")
    assert found == "room/a.h: a loop with a barrier is unrolled"
    short = "#pragma unroll\nfor (int k = 0; k < 2; ++k)\n    y[k] = 0;\n"
    for text in (before + loop, short + loop, short + "barrier(F);\n"):
        assert kernel_rules.unroll_complaints("room/a.h", text) == []


def test_forms_come_in_pairs_and_know_one_form_only():
    files = {"room/verb_cpu.cl": KERNEL % "1", "room/verb_gpu.cl": KERNEL % "2"}
    assert kernel_rules.form_complaints({**files, "room/other.cl": "USE_LOCAL"}) == []
    (found,) = kernel_rules.form_complaints({"room/verb_cpu.cl": KERNEL % "1"})
    assert found == "room/verb_cpu.cl: room/verb_gpu.cl is missing"
    (found,) = kernel_rules.form_complaints({**files, "room/verb_gpu.cl": "#if USE_LOCAL\n#endif"})
    assert found == "room/verb_gpu.cl: USE_LOCAL in a file of one form"


def test_includes_that_are_not_used_or_missing_are_found():
    include = '#include "room/{}.h"\n'.format
    good = {"room/a.h": HEADER, "room/b.cl": include("a") + KERNEL % "twice(1)"}
    assert kernel_rules.include_complaints(good) == []
    idle = {**good, "room/b.cl": include("a") + KERNEL % "p.twice"}
    assert kernel_rules.include_complaints(idle) == ["room/b.cl: uses nothing of room/a.h"]
    between = include("a") + "#define MORE (LIMIT + 1)\n"
    program = include("c") + KERNEL % "MORE + LIMIT"
    indirect = {"room/a.h": HEADER, "room/c.h": between, "room/b.cl": program}
    assert kernel_rules.include_complaints(indirect) == ["room/b.cl: uses LIMIT of room/a.h"]
    own = {**indirect, "room/b.cl": "#define LIMIT 9\n" + program}
    assert kernel_rules.include_complaints(own) == []


def test_types_options_and_headers_have_one_home():
    program = '#include "room/a.h"\ntypedef struct {\n    int x;\n} %s;\n'
    assert kernel_rules.name_complaints({"room/a.h": HEADER, "room/b.cl": program % "Line"}) == []
    (found,) = kernel_rules.name_complaints({"room/a.h": HEADER, "room/b.cl": program % "Point"})
    assert found == "room/b.cl: room/a.h defines Point, too"
    option = "#ifndef SIZE\n#define SIZE 3\n#endif\n"
    (found,) = kernel_rules.name_complaints({"room/b.cl": option, "room/c.cl": option})
    assert found == "room/c.cl: room/b.cl defines SIZE, too"
    assert kernel_rules.name_complaints({"room/a.h": HEADER}) == ["room/a.h: is never included"]
