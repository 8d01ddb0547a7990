"""The checks of the stages outside of a render, on any count of numbers."""

from __future__ import annotations

import pytest

from clgs.lab.selftest.training_checks import training_checks


@pytest.mark.parametrize("count", [1, 4, 5, 6, 11, 12, 100])
@pytest.mark.parametrize("specialisation", ["cpu", "gpu"])
def test_few_numbers_are_enough(open_device, specialisation, count):
    found = list(training_checks(open_device(specialisation), count))
    stages = {"scan", "sort", "quantize", "rate", "adam", "density", "growth", "exposure"}
    stages |= {"mask", "splats"}
    assert {check.stage for check in found} == stages
    assert [check for check in found if not check.passed] == []
