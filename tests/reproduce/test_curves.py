"""BD-rate against cases worked out by hand."""

import math

import pytest
from reproduce.curves import CurveError, bd_rate, rate_at

BASE = [(100.0, 30.0), (200.0, 32.0), (400.0, 34.0), (800.0, 36.0)]
"""Log bytes is a straight line of PSNR: a factor 2 every 2 dB."""


def scaled(curve, factor):
    return [(factor * size, psnr) for size, psnr in curve]


@pytest.mark.parametrize(
    ("curve", "change"),
    [
        *((scaled(BASE, factor), factor - 1) for factor in (0.5, 1.0, 1.25)),
        (scaled(BASE, 0.7)[::-1], -0.3),
        # A curve a decibel better saves what a decibel costs.
        ([(size, psnr + 1.0) for size, psnr in BASE], 1 / math.sqrt(2) - 1),
        # From 30 to 31 dB: log2 of the bytes falls short by 1 at 30 dB and by nothing at 31 dB.
        ([(50.0, 30.0), (100.0 * math.sqrt(2), 31.0)], 2**-0.5 - 1),
    ],
)
def test_the_change_is_the_mean_over_the_psnrs_that_both_reach(curve, change):
    assert bd_rate(curve, BASE) == pytest.approx(change, abs=1e-12)


def test_pchip_keeps_a_plateau_flat():
    # Three points, of which the last two have equal bytes: slopes are 0 at both ends of the plateau
    # and (2 + 1) / 2 = 1.5 at the start, by the three-point formula. Hermite's cubic on [30, 31]
    # has the mean 1/2 + 1.5/12; the plateau has 1.
    curve = [(1.0, 30.0), (math.e, 31.0), (math.e, 32.0)]
    flat = [(1.0, 30.0), (1.0, 32.0)]
    expected = (0.5 + 1.5 / 12 + 1.0) / 2
    assert bd_rate(curve, flat) == pytest.approx(math.expm1(expected), abs=1e-12)


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        (BASE[:1], "needs two points; there is 1"),
        ([], "needs two points; there is 0"),
        ([(100.0, 30.0), (120.0, 30.0)], "the same PSNR"),
        ([(100.0, 40.0), (120.0, 41.0)], "share no range"),
        ([(100.0, 36.0), (120.0, 41.0)], "share no range"),
        ([(0.0, 30.0), (120.0, 31.0)], "no number of bytes"),
        ([(10.0, math.nan), (120.0, 31.0)], "no number of bytes"),
    ],
)
def test_what_cannot_be_compared_says_why(curve, message):
    with pytest.raises(CurveError, match=message):
        bd_rate(curve, BASE)


def test_bytes_at_the_psnr_of_one_point():
    assert rate_at(BASE, (200.0, 33.0)) == pytest.approx(math.sqrt(2) - 1, abs=1e-12)
    with pytest.raises(CurveError, match=r"does not reach 29\.00 dB"):
        rate_at(BASE, (200.0, 29.0))
