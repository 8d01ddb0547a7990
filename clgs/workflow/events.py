"""What a workflow reports while it works. Workflows print nothing: one callback receives it all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from clgs.train.run.session import Progress

Item = TypeVar("Item")


@dataclass(frozen=True)
class Note:
    """A line that the user should read, but that is no result."""

    text: str


@dataclass(frozen=True)
class StageProgress:
    """How much of a stage is done. ``total`` is 0 if that is not known."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class TrainingProgress:
    """The state after a training step, and the number of steps of the whole run."""

    progress: Progress
    steps: int


@dataclass(frozen=True)
class RunStage:
    """``clgs run`` begins a stage, or skips it.

    ``text`` is a command that does the same work, or the reason why nothing is done.
    """

    stage: str
    text: str


@dataclass(frozen=True)
class StageRecord:
    """A stage of ``clgs run``, or its planning, gave ``record``."""

    record: object


@dataclass(frozen=True)
class StageFailure:
    """A stage of ``clgs run`` that the others do not need failed with ``error``."""

    stage: str
    error: Exception


Event = Note | StageProgress | TrainingProgress | RunStage | StageRecord | StageFailure
OnEvent = Callable[[Event], None]


def ignore(event: Event) -> None:
    """The callback of callers that want no events."""


def track(items: Iterable[Item], stage: str, total: int, on_event: OnEvent) -> Iterator[Item]:
    """Iterate over ``items`` and report how many of ``total`` are done."""
    for done, item in enumerate(items, 1):
        yield item
        on_event(StageProgress(stage, done, total))


def counter(stage: str, total: int, on_event: OnEvent) -> Callable[..., None]:
    """A function that reports one more of ``total`` as done; its arguments do not matter."""
    done = 0

    def advance(*_: object) -> None:
        nonlocal done
        done += 1
        on_event(StageProgress(stage, done, total))

    on_event(StageProgress(stage, 0, total))
    return advance
