"""The argument parser of ``clgs`` and of its commands, and the examples at the end of help."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

EXAMPLES: dict[str, tuple[str, ...]] = {
    "run": (
        "clgs run PHOTOS -o scene --time 5m",
        "clgs run data -o scene --steps 3000 --max-size 800",
    ),
    "devices": ("clgs devices", "clgs devices --json"),
    "doctor": ("clgs doctor", "clgs doctor data", "clgs doctor data --json"),
    "prepare": (
        "clgs prepare PHOTOS -o data",
        "clgs prepare clip.mp4 -o data --frames 80",
        "clgs prepare PHOTOS -o data --drop-doubtful",
        "clgs prepare PHOTOS -o data --quick",
    ),
    "train": (
        "clgs train data -o run --preset quick --downscale 4",
        "clgs train data -o run --preset quick --downscale 4 --resume",
        "clgs train data -o small --target-size 500000",
        "clgs train data -o longer --from run --steps 6000",
    ),
    "batch": (
        "clgs batch scenes.toml -o runs --workers 2",
        "clgs batch scenes.toml -o runs --scheduler tls://host:8786",
    ),
    "encode": (
        "clgs encode run -o scene.clgs --level max",
        "clgs encode run -o small.clgs --target-size 600k --data data",
    ),
    "decode": (
        "clgs decode scene.clgs -o scene.npz",
        "clgs decode scene.clgs -o part.npz --box -1,-1,-1,1,1,1",
    ),
    "crop": (
        "clgs crop run -o part.clgs --box -1,-1,-1,1,1,1",
        "clgs crop run -o object.clgs --object --seen 3",
        "clgs crop scene.clgs -o near.clgs --sphere 0,0,0,2 --data data",
    ),
    "pack": ("clgs pack splat.ply -o splat.clgs --step scale=0.03",),
    "unpack": ("clgs unpack splat.clgs -o splat.ply",),
    "render": (
        "clgs render run --data data -o views",
        "clgs render run/scene.clgs --data data --split train -o views",
        "clgs render run --data data --path orbit -o clip.mp4 --size 800x600",
        "clgs render splats.ply --path camera_path.json -o frames --depth",
    ),
    "eval": (
        "clgs eval run --data data",
        "clgs eval run/scene.clgs --data data --json scores.json",
        "clgs eval run --hashes run/hashes.json",
        "clgs eval splats.ply --data data --background white",
    ),
    "view": ("clgs view run --data data", "clgs view splats.ply --port 9000"),
    "export": (
        "clgs export run -o scene.html",
        "clgs export --viewer -o viewer.html",
        "clgs export run -o scene.ply",
        "clgs export run/scene.clgs --data data -o scene.sog --sh-degree 1",
        "clgs export data -o cameras.glb",
    ),
    "info": ("clgs info scene.clgs", "clgs info scene.clgs --json"),
    "selftest": ("clgs selftest", "clgs selftest --device 0 --verbose"),
    "bench": ("clgs bench step", "clgs bench ops --help"),
    "accept": (
        "clgs accept -o accept.json",
        "clgs accept -o accept.json --device 1 --data DATA --downscale 8",
    ),
    "conformance": ("clgs conformance -o here.json", "clgs conformance --check there.json"),
}
"""The examples of each command."""


def epilog(command: str) -> str:
    """The last paragraph of the command's help."""
    return "\n  ".join(("examples:", *EXAMPLES[command]))


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
