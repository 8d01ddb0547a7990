"""The argument parser of ``clgs`` and of each of its commands."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

SHELLS = ("bash", "zsh", "fish")
"""Shells that complete the commands, options and values of ``clgs``."""

RAW = ("examples:", "exit codes:")
"""The beginnings of paragraphs whose lines stay as they are."""

VALUES = re.compile(r"-(?:\d|\.\d|inf|nan|[xyz]$)", re.IGNORECASE)
"""Words that are values although they begin with a minus: numbers, lists of them, and axes."""


class Help(argparse.RawDescriptionHelpFormatter):
    """Descriptions as paragraphs as wide as the terminal; lists of examples line by line."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Fill paragraphs; a line that begins with an option begins a new one."""
        import textwrap

        parts = re.split(r"\n{2,}", text.strip())
        filled = []
        for part in parts:
            if part.startswith(RAW):
                filled.append(part)
                continue
            items = [" ".join(item.split()) for item in re.split(r"\n(?=--[\w-]+:)", part)]
            lines = (textwrap.fill(item, width, break_on_hyphens=False) for item in items)
            filled.append("\n".join(lines))
        return textwrap.indent("\n\n".join(filled), indent)


class Parser(argparse.ArgumentParser):
    """A parser that refuses unknown arguments itself, in one line without the usage.

    The standard parser of a command hands such arguments back to the parser of ``clgs``.
    """

    def __init__(self, **options: Any) -> None:
        options.setdefault("formatter_class", Help)
        super().__init__(**options)
        self._negative_number_matcher = VALUES  # the standard one knows no lists, and no 1e3
        self._words: list[str] = []

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Check a value; the answer to an unknown command names the one most like it."""
        if not isinstance(action, argparse._SubParsersAction) or value in action.choices:
            super()._check_value(action, value)
            return
        near = _nearest(value, action.choices)
        self.error(f"{action.metavar} {value!r} is unknown{near}")

    def error(self, message: str) -> NoReturn:
        """Exit with code 2; a mistyped option is named before what is missing."""
        mistyped = [word for word in self._words if self._suggestion([word])]
        if mistyped and message.startswith("the following arguments are required"):
            message = f"unrecognized arguments: {mistyped[0]}{self._suggestion(mistyped)}"
        elif files := [word for word in self._words if word[:1] == "-" and os.path.exists(word)]:
            message += f"; the file {files[0]} is written ./{files[0]}"
        if message.startswith("argument -"):
            message = message.removeprefix("argument ")
        else:
            message += f"; see {self.prog} --help"
        self.exit(2, f"clgs: error: {message}\n")

    def parse_known_args(  # type: ignore[override]  # one form of its four
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Parse, but refuse unknown words."""
        words = list(sys.argv[1:] if args is None else args)
        self._words = words
        found, unknown = super().parse_known_args(words, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._suggestion(unknown)}")
        return found, unknown

    def _suggestion(self, unknown: list[str]) -> str:
        """The option most like the first unknown one, in brackets; empty if none is near."""
        options = (word.partition("=")[0] for word in unknown if word.startswith("--"))
        first = next(options, "")
        if any(option.startswith(first) for option in self._option_string_actions):
            return ""
        return _nearest(first, self._option_string_actions)


class Completion(argparse.Action):
    """``--completion SHELL`` prints the script that lets a shell ask ``clgs`` for completions."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Print the script for the shell that ``values`` names; exits with code 0."""
        import argcomplete

        if values == "zsh":
            print("autoload -U compinit && compinit")
        print(argcomplete.shellcode(["clgs"], True, values))
        parser.exit(0)


def _nearest(word: str, known: Iterable[str]) -> str:
    """The one of ``known`` that is most like ``word``, in brackets; empty if none is near."""
    from difflib import get_close_matches

    near = get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
