"""Words and sentence forms that a reader would have to read twice.

``python -m tests.house.plain_english [PATH ...]`` lists them; without a path, those of all files.
"""

import ast
import re
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from tests.house.rules import blocks

ROOT = Path(__file__).resolve().parents[2]

INSTEAD = {
    "beside": "next to, in addition to, compared with",
    "besides": "also, except",
    "told": "given, known, distinguished",
    "so many": "this many, the number",
    "anew": "again, from the start",
    "whatever": "any, regardless of",
    "whoever": "who, anyone who",
    "in vain": "without success",
    "by turns": "alternately",
    "in turns": "alternately, interleaved",
    "sees to it": "makes sure",
    "see to it": "make sure",
    "made to measure": "of the exact size",
    "is to be": "must be, should be, is",
    "are to be": "must be, should be, are",
    "at hand": "available",
    "whence": "from where",
    "thereof": "of it",
    "therein": "in it",
    "lest": "so that not",
    "of late": "recently",
}
"""What to write instead of each."""

NO_SUBJECT = {"As", "At", "Besides", "By", "For", "From", "In", "Of", "Those", "Whatever", "With"}
"""First words of docstrings that lack a subject or a verb; for "As x, but" write "Like x, but"."""

WORDS = re.compile(rf"\b({'|'.join(INSTEAD)})\b", re.IGNORECASE)
SUFFIXES = {".py", ".md", ".cl", ".c", ".h", ".sh", ".js", ".html"}
FOLDERS = ("clgs", "codec_c", "docs", "kernels_cl", "scripts", "tests", "web")


def complaints(name: str, text: str) -> Iterator[str]:
    """What is not plain in ``text``, one line each; ``name`` is its path."""
    known = any(words in text.lower() for words in INSTEAD)
    for number, line in enumerate(text.splitlines() if known else (), 1):
        for match in WORDS.finditer(line):
            instead = INSTEAD[match[0].lower()]
            yield f'{name}:{number}: "{match[0]}"; write: {instead}'
    if name.endswith(".py"):
        for line, first in _first_words(text):
            if first in NO_SUBJECT:
                yield f'{name}:{line}: a docstring begins with "{first}"; say what it is or does'


def _first_words(text: str) -> Iterator[tuple[int, str]]:
    """(line, first word) of every docstring, those below attributes and constants too."""
    for child in chain.from_iterable(blocks(text)):
        match child:
            case ast.Expr(value=ast.Constant(value=str(string))) if string.strip():
                yield child.lineno, string.split()[0].rstrip(",.:")


def sources(paths: list[str]) -> Iterator[Path]:
    """The files below some paths from the root that hold prose."""
    for path in [ROOT / name for name in paths]:
        files = [path] if path.is_file() else sorted(path.rglob("*"))
        for file in files:
            inside = file.relative_to(ROOT).parts
            if file.suffix in SUFFIXES and file.is_file() and "__pycache__" not in inside:
                yield file


def found_in(paths: list[str]) -> Iterator[str]:
    """All complaints below some paths from the root; without one, in the whole checkout."""
    for file in sources(paths or [*FOLDERS, *(path.name for path in ROOT.glob("*.md"))]):
        name = file.relative_to(ROOT).as_posix()
        if not name.startswith("tests/house/") or "plain_english" not in name:
            yield from complaints(name, file.read_text(encoding="utf-8"))


def main() -> int:
    """List what is not plain; the exit code is 1 if there is any."""
    found = list(found_in(sys.argv[1:]))
    print("\n".join([*found, f"{len(found)} found"]))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
