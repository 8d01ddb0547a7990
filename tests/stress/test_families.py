"""The known failures of Gaussian splatting that the numeric suite holds tests against.

Tests carry ``@pytest.mark.family("N05")``; ``pytest -m family`` runs the suite,
``pytest -m "family and (slow or release)"`` its parts at full size.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r'@pytest\.mark\.family\("(N\d\d)"\)')

FAMILIES = {
    "N01": "a bad number in one splat reaches other splats",
    "N02": "a NaN passes a minimum and draws an opaque blob",
    "N03": "a quaternion without direction, or too long or short to square",
    "N04": "the exponential of a log scale overflows",
    "N05": "the determinant of a needle's covariance cancels",
    "N06": "the squared determinant overflows in the backward pass",
    "N07": "the division by depth at the near plane",
    "N08": "the slope limits assume a centred principal point",
    "N09": "the gradient goes through a clamped Jacobian as if it were free",
    "N10": "the low-pass blur of splats below a pixel",
    "N11": "the logarithm of an opacity below the alpha cut",
    "N12": "tile lists lose pixels that a splat touches",
    "N13": "1 / (1 - alpha) where alpha saturates",
    "N14": "transmittance and suffix colour in the backward pass",
    "N15": "forward and backward pass decide differently about a pixel",
    "N16": "the alpha cut silently takes the gradient of faint splats",
    "N17": "nothing is visible",
    "N18": "the number of intersections overflows 32 bits",
    "N19": "the list of intersections does not fit into memory",
    "N20": "a tile number overflows 16 bits",
    "N21": "more work-items than a launch may have",
    "N22": "a depth order with few bits, or without a rule for ties",
    "N23": "popping: splats are ordered by the depth of their centres (a limit of the method)",
    "N24": "coordinates far from the origin",
    "N25": "geometry in half precision",
    "N26": "images that are no multiple of the tile",
    "N27": "extreme focal lengths, and a camera inside of a splat",
    "N28": "a gradient that stops being finite after many steps",
    "N29": "results that differ from run to run, or with the number of threads",
    "N30": "the variances of SSIM cancel",
    "N31": "the rate of symbols in the tails, and at small scales",
    "N32": "rounding of halves",
    "N33": "quantised values that do not survive the round trip",
    "N34": "Adam with tiny moments and its bias correction",
    "N35": "sums of many terms",
    "N36": "colours of any size",
}


def test_names_are_consecutive():
    assert list(FAMILIES) == [f"N{number:02d}" for number in range(1, 37)]


def test_every_family_has_tests():
    texts = [path.read_text() for path in (ROOT / "tests").rglob("test_*.py")]
    found = {name for text in texts for name in MARK.findall(text)}
    assert found == set(FAMILIES)
