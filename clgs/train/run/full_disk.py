"""Checkpoints of a run whose disk may be full: no trained step is lost before it must be."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from clgs.errors import ClgsError
from clgs.files import is_full
from clgs.train.run.trainer import Trainer

Result = TypeVar("Result")

RETRY_STEPS = 100
"""After a checkpoint that found no room, steps until the next try."""

WAIT_SECONDS = 600.0
"""How long a trained scene that is on no disk waits for room."""

WAIT_INTERVAL = 5.0
"""Seconds between two tries of a waiting scene."""

_log = logging.getLogger(__name__)


class FullDiskError(ClgsError):
    """No room for a file of a run: names it, the remedy, and the step that a resumed run has."""


class Keeper:
    """Writes the checkpoints of a run."""

    def __init__(self, folder: Path, trainer: Trainer) -> None:
        """Keep ``trainer``, whose present state is on the disk already; ``folder``: run folder."""
        self._folder, self._trainer = folder / "checkpoint", trainer
        self._saved_step = trainer.steps_done
        self._full = False

    @property
    def interval(self) -> int:
        """Steps between checkpoints; 0 for none."""
        interval = self._trainer.config.checkpoint_interval
        return min(interval, RETRY_STEPS) if self._full else interval

    def save(self) -> None:
        """Write a checkpoint if the newest is of another step.

        Raises:
            FullDiskError: there is no room, even without the checkpoint before the newest.
            ClgsError: the file cannot be written.
        """
        if self._is_saved():
            return
        try:
            self._trainer.save(self._folder)
        except ClgsError as error:
            if isinstance(error.__cause__, OSError) and is_full(error.__cause__):
                raise self._no_room(error.__cause__) from error
            raise
        self._saved_step, self._full = self._trainer.steps_done, False

    def try_save(self) -> None:
        """Do what :meth:`save` does; a full disk gives a warning, once, and makes tries frequent.

        Raises:
            ClgsError: the file cannot be written for another reason.
        """
        try:
            self.save()
        except FullDiskError as error:
            if not self._full:
                _log.warning("%s; training goes on and tries again", error)
            self._full = True

    def with_room(self, work: Callable[[], Result]) -> Result:
        """What ``work()`` gives; it is repeated while the disk is full and no checkpoint is whole.

        Raises:
            FullDiskError: no room came in WAIT_SECONDS, or the run can be resumed without loss.
            OSError: another failure of ``work``.
        """
        deadline, warned = time.monotonic() + WAIT_SECONDS, False
        while True:
            try:
                return work()
            except OSError as error:
                if not is_full(error):
                    raise
                if self._is_saved() or time.monotonic() >= deadline:
                    raise self._no_room(error) from error
                if not warned:
                    _log.warning(
                        "%s: %s; free space: the scene waits for it up to %.0f minutes",
                        *(error.filename, error.strerror, WAIT_SECONDS / 60),
                    )
                warned = True
            time.sleep(WAIT_INTERVAL)
            self.try_save()

    def _is_saved(self) -> bool:
        return self._saved_step == self._trainer.steps_done

    def _no_room(self, error: OSError) -> FullDiskError:
        again = f"goes on after step {self._saved_step}" if self._saved_step else "starts again"
        return FullDiskError(
            f"{error.filename}: {error.strerror}; free space, then repeat the command with "
            f"--resume: it {again}"
        )
