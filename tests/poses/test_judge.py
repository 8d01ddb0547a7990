"""Every reason for a doubt, and that none is invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.poses.judging.agreement import Difference
from clgs.poses.judging.evidence import Explained
from clgs.poses.judging.figures import Figures
from clgs.poses.judging.judge import Comparison, is_ambiguous, judge
from clgs.poses.judging.verdict import DOUBTFUL, GOOD, LEFT_OUT

SOUND = Figures(800, 0.97, 4.5, 0.6, 10.0, (8.0, 9.0))
SAME = Difference(0.05, 0.1)
NAMES = [f"{number}.jpg" for number in range(12)]


def judged(changed: Figures = SOUND, second: Difference | None = SAME, rival=None):
    """The verdict on one photo among sound ones."""
    found = {**dict.fromkeys(NAMES, SOUND), "5.jpg": changed}
    again = dict.fromkeys(NAMES, SAME)
    again |= {"5.jpg": second} if second else {}
    if second is None:
        del again["5.jpg"]
    verdicts = judge(found, Comparison(again, {"5.jpg": rival} if rival else {}))
    assert {one.status for name, one in verdicts.items() if name != "5.jpg"} == {GOOD}
    return verdicts["5.jpg"]


def test_sound_photos_are_good():
    verdict = judged()
    assert (verdict.status, verdict.reasons, verdict.remedy) == (GOOD, (), "")
    assert verdict.turn == SAME.turn


@pytest.mark.parametrize(
    ("change", "second", "rival", "status", "reason"),
    [
        ({"observations": 30}, SAME, None, DOUBTFUL, "only 30 points"),
        ({"inlier_ratio": 0.4}, SAME, None, DOUBTFUL, "only 40 %"),
        ({"inlier_ratio": 0.1}, SAME, None, LEFT_OUT, "only 10 %"),
        ({"steps": (90.0, 100.0)}, SAME, None, DOUBTFUL, "turned by 90 degrees"),
        ({}, Difference(0.9, 0.1), None, DOUBTFUL, "turns it by 0.9"),
        ({}, Difference(0.1, 3.0), None, DOUBTFUL, "shifts it by 3.0"),
        ({}, Difference(80.0, 3.0), None, DOUBTFUL, "turns it by 80.0"),
        ({"observations": 59}, Difference(80.0, 3.0), None, LEFT_OUT, "turns it by 80.0"),
        ({}, None, None, DOUBTFUL, "could not place it"),
        ({}, SAME, Difference(120.0, 50.0), DOUBTFUL, "120 degrees apart"),
    ],
)
def test_every_doubt_has_a_reason_and_a_remedy(change, second, rival, status, reason):
    verdict = judged(replace(SOUND, **change), second, rival)
    assert verdict.status == status
    assert reason in "; ".join(verdict.reasons)
    assert verdict.remedy


def test_a_corner_in_the_sequence_is_no_doubt():
    assert judged(replace(SOUND, steps=(8.0, 100.0))).status == GOOD


def test_photos_without_order_are_not_compared_with_their_neighbours():
    found = dict.fromkeys(NAMES, replace(SOUND, steps=(70.0, 90.0)))
    verdicts = judge(found, Comparison(dict.fromkeys(NAMES, SAME), {}))
    assert {one.status for one in verdicts.values()} == {GOOD}


def test_unchecked_photos_are_judged_by_their_figures():
    verdicts = judge(dict.fromkeys(NAMES, SOUND), Comparison(None, {}))
    assert {one.status for one in verdicts.values()} == {GOOD}


def test_if_too_many_had_to_go_all_stay_in_doubt():
    bad = replace(SOUND, inlier_ratio=0.1)
    found = {name: bad if int(name[:-4]) < 5 else SOUND for name in NAMES}
    verdicts = judge(found, Comparison(None, {}))
    assert sum(one.status == DOUBTFUL for one in verdicts.values()) == 5


def explained(matches: list[int], found: list[int]) -> Explained:
    return Explained([], np.array(matches), np.array(found))


def test_contradicting_pairs():
    # Explained, contradicted, too few matches, one photo without a pose.
    assert explained([300, 100, 20, 500], [290, 5, 0, -1]).contradicted == 0.25
    assert explained([], []).contradicted == 0.0


def test_ambiguity():
    clear = explained([100] * 50, [90] * 50)
    same, other = Comparison(dict.fromkeys(NAMES, SAME), {}), Difference(150.0, 40.0)
    assert not is_ambiguous(same, clear, 12)
    assert not is_ambiguous(Comparison({"1.jpg": other}, {}), clear, 12)
    assert is_ambiguous(Comparison({"1.jpg": other, "2.jpg": other}, {}), clear, 12)
    assert is_ambiguous(Comparison({"1.jpg": other}, {"2.jpg": other}), clear, 12)
    assert is_ambiguous(same, explained([100] * 50, [90] * 48 + [3] * 2), 12)
    assert not is_ambiguous(same, explained([100] * 50, [90] * 49 + [3]), 12)
