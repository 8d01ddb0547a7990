"""Times of commands that take turns: turns.py [--turn SECONDS] COMMAND COMMAND [...].

Each COMMAND is one argument, split like a shell would. While one runs the others are stopped, so
that all of them meet the same machine, whose speed may drift. Prints of each the seconds for which
it ran and the seconds of processor that it took, start-up included, and what share of the last
one's they are. What the commands print is not shown. POSIX alone.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

LOOK = 0.01
"""Seconds between looks whether a command has ended."""


@dataclass
class Runner:
    """A command, stopped unless it is its turn."""

    words: list[str]
    process: subprocess.Popen[bytes]
    seconds: float = 0.0
    processor: float = 0.0
    code: int | None = None

    @classmethod
    def start(cls, command: str) -> Runner:
        """The process of ``command``, in a session of its own, stopped at once."""
        words = shlex.split(command)
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(words, stdout=quiet, stderr=quiet, start_new_session=True)
        os.killpg(process.pid, signal.SIGSTOP)
        return cls(words, process)

    def take_turn(self, seconds: float) -> None:
        """Let it run so long, or to its end."""
        os.killpg(self.process.pid, signal.SIGCONT)
        start = time.perf_counter()
        while self.code is None and time.perf_counter() - start < seconds:
            time.sleep(LOOK)
            ended, status, usage = os.wait4(self.process.pid, os.WNOHANG)
            if ended:
                self.code = os.waitstatus_to_exitcode(status)
                self.processor = usage.ru_utime + usage.ru_stime
        self.seconds += time.perf_counter() - start
        if self.code is None:
            os.killpg(self.process.pid, signal.SIGSTOP)

    def end(self) -> None:
        """Kill it if it still runs."""
        if self.code is None:
            os.killpg(self.process.pid, signal.SIGKILL)


def main() -> int:
    """Run all commands; 1 if one of them fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turn", type=float, default=2.0, help="seconds; default: 2")
    parser.add_argument("commands", nargs="+", metavar="COMMAND")
    args = parser.parse_args()
    runners = [Runner.start(command) for command in args.commands]
    try:
        while any(runner.code is None for runner in runners):
            for runner in runners:
                if runner.code is None:
                    runner.take_turn(args.turn)
    finally:
        for runner in runners:
            runner.end()
    last = runners[-1]
    for runner in runners:
        print(
            f"{runner.seconds:.1f} s ({runner.seconds / last.seconds:.2f}), "
            f"{runner.processor:.1f} s of processor ({runner.processor / last.processor:.2f}), "
            f"exit {runner.code}: {shlex.join(runner.words)}"
        )
    return int(any(runner.code != 0 for runner in runners))


if __name__ == "__main__":
    sys.exit(main())
