"""Parts that loose matches joined: confirmed they stay, else they go."""

from __future__ import annotations

import pytest

from clgs.poses.judging.parts import leave_out_parts
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT, PhotoVerdict

PART = ["f.jpg", "g.jpg", "h.jpg"]
REST = ["a.jpg", "b.jpg", "c.jpg", "d.jpg"]


def left_out(statuses: str, parts: list[list[str]], checked: bool = True) -> list[str]:
    """Names left out of REST and PART with these statuses, by first letter."""
    known = {"g": GOOD, "d": DOUBTFUL}
    judged = {
        name: PhotoVerdict(name, known[letter], reasons=() if letter == "g" else ("for a reason",))
        for name, letter in zip(REST + PART, statuses, strict=False)
    }
    found = leave_out_parts(judged, parts, checked)
    gone = [name for name, one in found.items() if one.status == LEFT_OUT]
    for name in gone:
        assert found[name].reasons[0] == "it and 2 others form a part of their own"
        assert found[name].reasons[1:] == judged[name].reasons
        assert found[name].remedy
    kept = {name: one for name, one in found.items() if name not in gone}
    assert kept == {name: judged[name] for name in kept}
    return gone


@pytest.mark.parametrize(
    ("statuses", "parts", "expected"),
    [
        ("ggggggg", [PART], []),  # the second reconstruction agrees
        ("ggggddd", [PART], PART),
        ("gggdgdd", [PART], PART),
        ("ggggggd", [PART], []),
        ("ddddddd", [PART], []),  # which of both is wrong cannot be told
        ("ggggddd", [], []),
        ("ggggddd", [["h.jpg"]], []),  # a photo is no part
        ("gggg", [PART], []),  # it was not joined
    ],
)
def test_a_part_stays_only_if_it_is_confirmed(statuses, parts, expected):
    assert left_out(statuses, parts) == expected


@pytest.mark.parametrize(
    ("statuses", "parts", "expected"),
    [
        ("ggggggg", [PART], PART),
        ("ggggddd", [PART], PART),
        ("ddddggg", [PART], []),  # which of both is wrong cannot be told
        ("ggggggg", [["h.jpg"]], []),
        ("gggg", [PART], []),
    ],
)
def test_without_a_second_reconstruction_nothing_confirms_a_part(statuses, parts, expected):
    assert left_out(statuses, parts, checked=False) == expected
