"""Makes mutants for ``mutation_check.py``: a mutant is a kernel or an op with one seeded bug.

Rules find the bugs in the text of today, so that no list breaks when a kernel changes. A mutant's
number is a hash of the file, the rule and the line. It stays while other lines change.
"""

from __future__ import annotations

import hashlib
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
from tests.house.rules import kernels_in, op_paths, plain_c, stage_of  # noqa: E402 - of this checkout

STAGES = op_paths(ROOT)

SWAPS = {
    "+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "+=": "-=", "-=": "+=",
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
    "&": "|", "|": "&", "&&": "||", "||": "&&", "<<": ">>", ">>": "<<", "and": "or", "or": "and",
    "min": "max", "max": "min", "fmin": "fmax", "fmax": "fmin",
}  # fmt: skip
"""Operators need blanks on both sides, as clang-format writes binary ones; functions a bracket."""

WORDS = "|".join(word for word in SWAPS if word.isalpha())
SIGNS = "|".join(re.escape(sign) for sign in sorted(SWAPS, key=len) if not sign.isalpha())
C_RULES = {
    "swap": rf"(?<= )(?:{SIGNS})(?= )|\b(?:{WORDS})(?=\()",
    "constant": r"(?<![\w.\[])\d+(?:\.\d+)?(?:e-?\d+)?(?=f?\b(?![\w.]))",
    "index": r"(?<=[\w\]]\[)[^\[\]]*[a-z_][^\[\]]*(?=\])",
    "sign": r"(?<=[=(,:?] )-(?=[\w(])|(?<=\()-(?=[a-z(])",
    "guard": r"(?<=\bif \().*(?=\)(?: \{)?$)",
    "statement": r"(?<=^ )[A-Za-z][\w.>\[\]-]* [+|&-]?= [^;{]*;|(?<=^ )[A-Za-z_]\w*\([^;{]*\);",
}
"""What each rule finds in a line of C without comments, in which one blank begins the line. A
"statement" is an assignment or a call, and never a declaration.
"""


@dataclass(frozen=True)
class Mutant:
    """One seeded bug.

    file: path from the root. stages: their tests judge it. form: "cpu" or "gpu" if only this form
    of the kernels holds it, else empty. rule: the kind of bug. what: the line before and after.
    text: the whole file with the bug. number: eight hexadecimal digits.
    """

    file: str
    stages: tuple[str, ...]
    form: str
    rule: str
    what: str
    text: str
    number: str


Change = tuple[str, int, int, str]
"""Rule, first and last position of the text that is replaced, and what replaces it."""


def all_mutants() -> list[Mutant]:
    """Every mutant of every kernel and op that has tests."""
    files = [*(ROOT / "kernels_cl").rglob("*.*"), *(ROOT / "clgs/ops").rglob("*.py")]
    names = sorted(path.relative_to(ROOT).as_posix() for path in files)
    return [mutant for name in names if stages_of(name) for mutant in mutants_of(name)]


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a kernel, a header or an op, in the order of the rules."""
    text = (ROOT / file).read_text(encoding="utf-8")
    found, seen = [], Counter[str]()
    for rule, start, end, new in python_changes(text) if file.endswith(".py") else c_changes(text):
        changed = text[:start] + new + text[end:]
        first, last = text.rfind("\n", 0, start) + 1, text.find("\n", end)
        after = changed[first : last + len(changed) - len(text)]
        what = f"{' '.join(text[first:last].split())}  ->  {' '.join(after.split())}"
        seen[what] += 1
        number = hashlib.sha256(f"{file} {what} {seen[what]}".encode()).hexdigest()[:8]
        found.append(Mutant(file, stages_of(file), form_of(file), rule, what, changed, number))
    return found


def c_changes(text: str) -> Iterator[Change]:
    """Changes of OpenCL C, outside of comments, strings and preprocessor lines."""
    plain = plain_c(text)
    for rule, pattern in C_RULES.items():
        start = 0
        for line in plain.splitlines(keepends=True):
            indent = max(len(line) - len(line.lstrip(" ")) - 1, 0)
            for match in re.finditer(pattern, line[indent:].rstrip("\n")):
                first = start + indent + match.start()
                for new in replacements(rule, match[0]):
                    yield rule, first, first + len(match[0]), new
            start += len(line)


def replacements(rule: str, old: str) -> list[str]:
    """What takes the place of ``old``: another operator, another number, or nothing."""
    if rule == "swap":
        return [SWAPS[old]]
    if rule == "constant":
        return [str(int(old) + 1) if old.isdigit() else repr(2 * float(old) or 1.0)]
    if rule == "guard":
        return ["1", "0"]
    return {"index": [f"{old} + 1"], "sign": [""], "statement": [";"]}[rule]


def python_changes(text: str) -> Iterator[Change]:
    """Changes of an op: other operators and other integers."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        binary = before.isidentifier() or before[-1:] in (")", "]") or before.isdigit()
        first = starts[token.start[0] - 1] + token.start[1]
        if token.string in SWAPS and binary and token.string not in ("|", "&"):
            yield "swap", first, first + len(token.string), SWAPS[token.string]
        elif token.type == tokenize.NUMBER and token.string.isdigit():
            yield "constant", first, first + len(token.string), str(int(token.string) + 1)
        before = token.string


def form_of(file: str) -> str:
    """The only form of the kernels that a file belongs to, else an empty text."""
    if file.endswith("_gpu.cl") or "/group/" in file:
        return "gpu"
    return "cpu" if file.endswith("_cpu.cl") or "/block/" in file else ""


@cache
def stages_of(file: str) -> tuple[str, ...]:
    """The stages that a kernel, a header or an op is part of."""
    if file.endswith(".py"):
        return (Path(file).stem,) if Path(file).stem in STAGES else ()
    return tuple(sorted({stage for stage, files in _files_of_stages().items() if file in files}))


@cache
def _files_of_stages() -> dict[str, set[str]]:
    """The programs of each stage, and all headers that these include, directly or not."""
    found: dict[str, set[str]] = {stage: set() for stage in STAGES}
    for program in (ROOT / "kernels_cl").rglob("*.cl"):
        kernels = kernels_in(program.read_text(encoding="utf-8"))
        files = found.get(stage_of(kernels[0], STAGES) or "", set())
        waiting = [program.relative_to(ROOT / "kernels_cl").as_posix()]
        while waiting:
            name = waiting.pop()
            if f"kernels_cl/{name}" not in files:
                files.add(f"kernels_cl/{name}")
                text = (ROOT / "kernels_cl" / name).read_text(encoding="utf-8")
                waiting += re.findall(r'^\s*#\s*include\s+"([^"]+)"', text, re.M)
    return found
