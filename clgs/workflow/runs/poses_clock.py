"""How long poses take, by the first features and pairs of the photos themselves."""

from __future__ import annotations

import time
from collections.abc import Callable

from clgs.workflow.events import Event, OnEvent, StageProgress
from clgs.workflow.runs.plan import PosesTime

OFF = 0.3
"""A plan is made again if the poses take this share more or less than was said."""

ENOUGH = {"features": 0.04, "matches": 0.5}
"""Shares of these stages after which their time is known; pairs that show nothing come first."""


class PosesClock:
    """Follows the stages of ``prepare``, and compares their time with what was said."""

    def __init__(
        self,
        said: PosesTime,
        on_news: Callable[[float, float], None],
        on_event: OnEvent,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Receive events, which are passed to ``on_event``.

        Args:
            said: what was planned.
            on_news: is called at once if that is wrong by more than OFF, with the seconds of all
                stages that were said and those that they are going to take.
            on_event: receives all events.
            clock: in seconds.
        """
        self._planned, self._said = said, said.seconds
        self._on_news, self._on_event, self._clock = on_news, on_event, clock
        self._began = dict[str, tuple[int, float]]()
        self._found = dict[str, float]()

    def __call__(self, event: Event) -> None:
        """Pass an event on; one of a stage may tell how long it takes."""
        self._on_event(event)
        if not isinstance(event, StageProgress) or event.stage not in ENOUGH:
            return
        stage, now = event.stage, self._clock()
        first, began = self._began.setdefault(stage, (event.done, now))
        enough = event.done - first >= ENOUGH[stage] * event.total
        if stage in self._found or event.done == first or not enough:
            return
        self._found[stage] = (now - began) * event.total / (event.done - first)
        # What is not known yet is taken to differ from the plan as what is known.
        plan = {"features": self._planned.features, "matches": self._planned.matches}
        planned, known = sum(plan[each] for each in self._found), sum(self._found.values())
        taken = known / max(planned, 1e-9) * (self._planned.seconds - planned) + known
        if abs(taken - self._said) > OFF * self._said:
            said, self._said = self._said, taken
            self._on_news(said, taken)
