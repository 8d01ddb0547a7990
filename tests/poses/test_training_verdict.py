"""What a short training adds to the verdict: doubts with a reason, and a remark on the whole."""

from __future__ import annotations

import pytest

from clgs.poses.judging.training import MOST, REASON, REMEDY, untrained, with_training
from clgs.poses.judging.verdict import (
    DOUBTFUL,
    GOOD,
    LEFT_OUT,
    PhotoVerdict,
    Verdict,
    verdict_of,
)

NAMES = [f"{number}.jpg" for number in range(9)]


def verdict(**changed: PhotoVerdict) -> Verdict:
    photos = tuple(changed.get(f"p{i}", PhotoVerdict(name, GOOD)) for i, name in enumerate(NAMES))
    figures = (9, 9, 1000, 4000, 0.5, 4.0, "incremental", {}, ())
    return Verdict(*figures, photos, True, False, 0.0, "sure: of it")


def test_photo_that_training_shows_stays_good():
    found = with_training(verdict(), dict.fromkeys(NAMES, 0.05))
    assert {one.status for one in found.photos} == {GOOD}
    assert {one.unexplained for one in found.photos} == {0.05}
    assert found.sure == "sure: of it; a short training shows every photo"


def test_photo_that_training_cannot_show_is_doubtful():
    found = with_training(verdict(), {**dict.fromkeys(NAMES, 0.05), "4.jpg": 0.9})
    [doubted] = found.of(DOUBTFUL)
    reason = f"{REASON}: 90% of it is unexplained, 5% of most"
    assert (doubted.name, doubted.reasons, doubted.remedy) == ("4.jpg", (reason,), REMEDY)
    assert found.sure == "mostly sure: of it; a short training does not show 1 of 9 photos"
    assert verdict_of(found.plain()) == found


@pytest.mark.parametrize(
    ("usual", "one"), [(0.01, MOST), (0.2, 0.59), (0.4, 1.1)], ids=["least", "three times", "bad"]
)
def test_photo_is_in_doubt_only_if_it_is_far_worse_than_others(usual, one):
    found = with_training(verdict(), {**dict.fromkeys(NAMES, usual), "4.jpg": one})
    assert found.of(DOUBTFUL) == []
    found = with_training(verdict(), {**dict.fromkeys(NAMES, usual), "4.jpg": one + 0.2})
    assert len(found.of(DOUBTFUL)) == 1


def test_photos_that_training_hardly_shows_are_a_remark():
    found = with_training(verdict(), dict.fromkeys(NAMES, 0.8))
    assert "hardly shows the photos" in found.sure


def test_other_doubts_and_photos_without_a_pose_stay():
    changed = {
        "p0": PhotoVerdict("0.jpg", LEFT_OUT, reasons=("no pose",), remedy="sharper"),
        "p1": PhotoVerdict("1.jpg", DOUBTFUL, reasons=("it turns",), remedy="more"),
    }
    shares = {**dict.fromkeys(NAMES[1:], 0.05), "1.jpg": 0.9}
    left, doubted, *_ = with_training(verdict(**changed), shares).photos
    assert left == changed["p0"]
    assert doubted.reasons[0] == "it turns"
    assert doubted.reasons[1].startswith(REASON)
    assert doubted.remedy == "more"


def test_training_that_was_not_made_says_so():
    assert with_training(verdict(), {}) == verdict()
    assert untrained(verdict()).sure == "sure: of it; not tested by a short training"
