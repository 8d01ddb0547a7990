"""The draw of the measurement of attribute coding has the entropy that it states."""

from __future__ import annotations

import numpy as np
import pytest

from scripts.bench.attributes import GROUPS, draw


@pytest.mark.parametrize("group", GROUPS)
def test_the_entropy_is_the_one_that_is_stated(group: str) -> None:
    """Within five standard deviations of the mean surprise.

    Counts of n draws have less entropy than the law by (values - 1) / (2 n ln 2), which is added.
    """
    _, bits = GROUPS[group]
    values = draw(200_000, 1, bits).ravel()
    count = np.unique(values, return_counts=True)[1]
    share = count / len(values)
    surprise = -np.log2(share)
    entropy = (share * surprise).sum() + (len(count) - 1) / (2 * len(values) * np.log(2))
    deviation = np.sqrt((share * (surprise - entropy) ** 2).sum() / len(values))
    assert abs(entropy - bits) <= 5 * deviation
    assert 5 * deviation <= 0.02
