"""What stages must move and compute at least, and how near they come to a device's limits."""

from __future__ import annotations

import pytest

from clgs.lab.bench.ops import (
    FORMULAS,
    Counts,
    DeviceLimits,
    measure_limits,
    share_of_limit,
    worst_check,
)
from clgs.lab.selftest.reference_render import Check

COUNTS = Counts(A=10, V=8, N=100, I=400, B=20_000, P=256, M=900, E=50)


def test_formulas_by_hand():
    assert FORMULAS["blend forward"].evaluate(COUNTS) == (36 * 400 + 20 * 256, 36 * 20_000)
    assert FORMULAS["adam"].text() == "28 M B, 14 M flop"


def test_the_nearer_limit_binds():
    share = share_of_limit("blend forward", COUNTS, 1.0, DeviceLimits(1e9, 1e9))
    assert share.of_limit == pytest.approx(0.72)
    assert share.bound == "FMA"
    assert share_of_limit("blend forward", COUNTS, 1.0, DeviceLimits(1e6, 1e9)).bound == "copy"
    assert share_of_limit("density", COUNTS, 1.0, DeviceLimits(1e9, 1e9)) is None


def test_a_failed_check_is_the_worst():
    good, near, failed = (
        Check("cull", n, e, 1.0, 0.0) for n, e in (("a", 0.1), ("b", 0.9), ("c", 2.0))
    )
    assert worst_check("cull", [good, near]) is near
    assert worst_check("cull", [good, near, failed]) is failed
    nan = Check("backward", "x", float("nan"), 1.0, 0.0)
    assert worst_check("blend backward", [good, nan]) is nan
    assert worst_check("density", [good]) is None


@pytest.mark.slow
def test_limits_are_rates(device):
    limits = measure_limits(device)
    assert limits.bytes_per_second > 1e6
    assert limits.flops_per_second > 1e6
