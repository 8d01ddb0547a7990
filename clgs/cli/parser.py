"""The argument parser of ``clgs`` and of each of its commands."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

_NUMBERS = re.compile(r"-(\d|\.\d|inf)")
"""The start of a word that is a negative number, or a list that begins with one."""


class Parser(argparse.ArgumentParser):
    """A parser that refuses unknown arguments itself, in one line without the usage.

    The standard one of a command hands such arguments back to that of ``clgs``.
    """

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        if message.startswith("argument -"):
            message = message.removeprefix("argument ")
        else:
            message += f"; see {self.prog} --help"
        self.exit(2, f"clgs: error: {message}\n")

    def parse_known_args(  # type: ignore[override]  # one form of its four
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As in the base class, but unknown words are errors, and lists may begin with a minus."""
        words = list(sys.argv[1:] if args is None else args)
        found, unknown = super().parse_known_args(_join_numbers(words), namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._suggestion(unknown)}")
        return found, unknown

    def _suggestion(self, unknown: list[str]) -> str:
        """The option most like the first unknown one, in brackets; empty if none is near."""
        from difflib import get_close_matches

        options = (word.partition("=")[0] for word in unknown if word.startswith("--"))
        near = get_close_matches(next(options, ""), self._option_string_actions, n=1)
        return f" (did you mean {near[0]}?)" if near else ""


def _join_numbers(words: list[str]) -> list[str]:
    """``--option -1,2`` as ``--option=-1,2``: the base class takes lists for unknown options."""
    joined: list[str] = []
    for word in words:
        if joined and re.fullmatch(r"--[\w-]+", joined[-1]) and _NUMBERS.match(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined
