"""The checks of the stages: on any count of numbers, and of all programs."""

from __future__ import annotations

import pytest

from clgs.lab.selftest.render_checks import TINY, selftest
from clgs.lab.selftest.training_checks import training_checks
from clgs.opencl.programs import programs_of_form

NOT_CHECKED = {"limits/limits", "scan/fits", "blend/sums", "tiles/by_row"}
"""Programs of `clgs bench`, of limited memory, of counts of importance, and of long lists."""


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 4, 5, 6, 11, 12, 100])
@pytest.mark.parametrize("specialisation", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_few_numbers_are_enough(open_device, specialisation, count):
    found = list(training_checks(open_device(specialisation), count))
    stages = {"scan", "sort", "quantize", "rate", "adam", "density", "growth", "exposure"}
    stages |= {"mask", "splats", "match", "views", "harmonics", "channels"}
    assert {check.stage for check in found} == stages
    assert [check for check in found if not check.passed] == []


@pytest.mark.parametrize("specialisation", ["cpu", pytest.param("gpu", marks=pytest.mark.slow)])
def test_a_kernel_of_every_program_is_checked(open_device, specialisation, monkeypatch):
    device, used = open_device(specialisation), set()
    find = device.kernel

    def kernel(program, name, **macros):
        used.add(program)
        return find(program, name, **macros)

    monkeypatch.setattr(device, "kernel", kernel)
    assert [check for check in selftest(device, TINY) if not check.passed] == []
    unchecked = programs_of_form(specialisation).keys() - used - NOT_CHECKED
    assert not unchecked, f"{unchecked}: docs/contributing/add_an_op.md, step 6"
