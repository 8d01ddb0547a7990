"""The stages of `clgs run`: commands of clgs, one after the other, timed and announced."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from clgs.errors import ClgsError


class StageError(ClgsError):
    """A command failed, and has said why; its exit code is passed on."""

    def __init__(self, name: str, code: int) -> None:
        super().__init__(f"{name} failed; mend that and repeat the command with --resume")
        self.exit_code = code


@dataclass
class Stages:
    """Runs commands in this process and keeps the seconds of each stage.

    made: bytes of the files that they made, by name; on_time is called whenever seconds have grown.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    made: dict[str, int] = field(default_factory=dict)
    on_time: Callable[[], None] = lambda: None

    def run(self, name: str, made: Path, *words: str | Path) -> None:
        """Run ``clgs NAME WORDS`` as stage ``name``, unless ``made`` is there as it was made.

        Raises:
            StageError: it failed.
        """
        code = self.attempt(name, made, *words)
        if code:
            raise StageError(name, code)

    def attempt(self, name: str, made: Path, *words: str | Path) -> int:
        """As :meth:`run`, but the exit code is returned.

        Raises:
            KeyboardInterrupt: the command was interrupted.
        """
        from clgs.cli.main import run_command

        if made.is_dir() or (made.is_file() and self.made.get(made.name) == made.stat().st_size):
            print(f"\n[{name}] is there: {made}")
            return 0
        command = [str(word) for word in words]
        print(f"\n[{name}] {shlex.join(['clgs', *command])}", flush=True)
        with self.timed(name):
            try:
                code = run_command(command)
            except SystemExit as error:  # of the parser
                code = int(error.code or 0)
            if code == 0 and made.is_file():
                self.made[made.name] = made.stat().st_size
            return code

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Add the seconds of the block to those of stage ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            self.on_time()
