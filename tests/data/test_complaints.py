"""Cameras apart from the rest, and those that only walked away."""

import numpy as np
import pytest

from clgs.data.complaints import lonely


@pytest.mark.parametrize(
    ("count", "others", "alone"),
    [
        (20, [[12.0, 0.0, 0.0]], True),
        (20, np.linspace([0.0, 0.0, 0.0], [15.0, 0.0, 0.0], 9)[1:], False),
        (20, [[90.0, 0.0, 0.0], [91.0, 0.0, 0.0]], True),
        (3, [[90.0, 0.0, 0.0]], False),
    ],
    ids=["one far from all", "who walks away", "several that no capture has", "among few"],
)
def test_cameras_far_from_all_others_are_lonely(rng, count, others, alone):
    found = lonely(np.vstack([rng.normal(size=(count, 3)), others]))
    assert (found[count:] == alone).all()
    assert not found[:count].any()
