"""Parts of a scene that strict matches did not join to the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from clgs.poses.judging.verdict import GOOD, LEFT_OUT, PhotoVerdict

CONNECT = "take photos that connect both parts, or prepare each by itself"


def leave_out_parts(
    judged: Mapping[str, PhotoVerdict], parts: Sequence[Sequence[str]], checked: bool
) -> dict[str, PhotoVerdict]:
    """Verdicts with the parts left out that the second look joined, but the test did not confirm.

    A part hangs together by itself, so that a few loose matches turn all of it to a wrong side at
    once. If most of the others are good, it goes unless a second reconstruction was made and
    most of its photos are good, too.

    Args:
        judged: of the photos with a pose, by name.
        parts: names of the photos of each model that the strict matches made beside the kept one.
        checked: whether a second reconstruction was to be made; without it nothing confirms.
    """
    found = dict(judged)
    for names in parts:
        joined = [name for name in names if name in judged]
        others = [one for name, one in judged.items() if name not in joined]
        confirmed = checked and _mostly_good([judged[name] for name in joined])
        if len(names) > 1 and not confirmed and _mostly_good(others):
            found |= {name: _left_out(judged[name], len(names) - 1) for name in joined}
    return found


def part_reason(others: int) -> str:
    """Why a photo is left out that forms a part with ``others`` more."""
    return f"it and {others} other{'s' * (others > 1)} form a part of their own"


def _mostly_good(verdicts: Sequence[PhotoVerdict]) -> bool:
    return 2 * sum(one.status == GOOD for one in verdicts) > len(verdicts)


def _left_out(verdict: PhotoVerdict, others: int) -> PhotoVerdict:
    reasons = (part_reason(others), *verdict.reasons)
    return replace(verdict, status=LEFT_OUT, reasons=reasons, remedy=CONNECT)
