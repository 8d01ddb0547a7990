"""The rules of ARCHITECTURE.md for ``kernels_cl``, as functions from text to complaints.

Files are given by their path from ``kernels_cl``, as includes name them: "blend/record.h".
"""

import re
from collections.abc import Mapping

from tests.house.rules import plain_c, without_attributes, without_comments

_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*"([^"]+)"', re.M)
_OPTION = re.compile(r"^#ifndef (\w+)\n#define \1 ", re.M)
_HELPER = re.compile(r"\bstatic\s+inline\s+[\w\s*]*?(\w+)\s*\(")


def inline_complaints(path: str, text: str) -> list[str]:
    """Helper functions that are not ``static inline``.

    C99's plain ``inline`` defines no symbol that a call may be linked with: drivers that do not
    inline the call fail to build the program.
    """
    code = without_attributes(without_comments(text))
    complaints = [
        f"{path}: inline without static"
        for match in re.finditer(r"\binline\b", code)
        if not re.search(r"\bstatic\s+$", code[: match.start()])
    ]
    plain = without_attributes(plain_c(text))
    heads = re.findall(r"(?:^|[;}])([^;{}]*)\{", _top_level(plain))
    for head in heads:
        function = re.search(r"(\w+)\s*\([^()]*\)\s*$", head)
        if function and not re.search(r"\bstatic\s+inline\b|\b(?:__)?kernel\b", head):
            complaints.append(f"{path}: {function[1]} is neither a kernel nor static inline")
    return complaints


def _top_level(text: str) -> str:
    """C text without what stands between braces."""
    depth, kept = 0, []
    for char in text:
        depth -= char == "}"
        if depth == 0:
            kept.append(char)
        depth += char == "{"
    return "".join(kept)


def form_complaints(files: Mapping[str, str]) -> list[str]:
    """CPU or GPU forms without a partner, or with code of both."""
    complaints = []
    for path, text in files.items():
        for form, other in (("cpu", "gpu"), ("gpu", "cpu")):
            if not path.endswith(f"_{form}.cl"):
                continue
            partner = path.replace(f"_{form}.cl", f"_{other}.cl")
            if partner not in files:
                complaints.append(f"{path}: {partner} is missing")
            if "USE_LOCAL" in text:
                complaints.append(f"{path}: USE_LOCAL in a file of one form")
    return complaints


def unroll_complaints(path: str, text: str) -> list[str]:
    """Loops with a barrier that a pragma unrolls: PoCL 3.1 makes other sums of them."""
    code = without_comments(text)
    loops = (_statement(code[at.end() :]) for at in re.finditer(r"#pragma unroll\b.*\n", code))
    return [f"{path}: a loop with a barrier is unrolled" for loop in loops if "barrier(" in loop]


def _statement(code: str) -> str:
    """The statement that begins on the first line, to the end of its last one."""
    depth, lines = 0, []
    for line in code.splitlines():
        lines.append(line)
        depth += line.count("{") - line.count("}")
        if depth <= 0 and line.rstrip().endswith((";", "}")):
            break
    return "\n".join(lines)


def include_complaints(files: Mapping[str, str]) -> list[str]:
    """Includes of which nothing is used, and what is used of headers that are included indirectly.

    A header defines its macros, types and ``static inline`` functions, and what a line such as
    ``DEFINE_X(name, ...)`` names first.
    """
    defined = {path: defined_names(text) for path, text in files.items()}
    direct = {path: _INCLUDE.findall(text) for path, text in files.items()}
    complaints = []
    for path, text in files.items():
        used = used_names(text)
        complaints += [
            f"{path}: uses nothing of {header}"
            for header in direct[path]
            if not used & defined[header]
        ]
        at_hand = set().union(defined[path], *(defined[header] for header in direct[path]))
        for header in sorted(_reached(path, direct) - {path, *direct[path]}):
            names = sorted(used & defined[header] - at_hand)
            complaints += [f"{path}: uses {', '.join(names)} of {header}"] if names else []
    return complaints


def _reached(path: str, direct: Mapping[str, list[str]]) -> set[str]:
    found: set[str] = set()
    ahead = list(direct[path])
    while ahead:
        header = ahead.pop()
        if header not in found:
            found.add(header)
            ahead += direct[header]
    return found


def name_complaints(files: Mapping[str, str]) -> list[str]:
    """Types and build options that two files define, and headers that no file includes."""
    complaints = []
    homes: dict[str, str] = {}
    for path, text in files.items():
        for name in sorted(_types(text)) + _OPTION.findall(text):
            if homes.setdefault(name, path) != path:
                complaints.append(f"{path}: {homes[name]} defines {name}, too")
    included = {header for text in files.values() for header in _INCLUDE.findall(text)}
    headers = {path for path in files if path.endswith(".h")}
    return complaints + [f"{path}: is never included" for path in sorted(headers - included)]


def _types(text: str) -> set[str]:
    plain = _top_level(without_attributes(plain_c(text)))
    return {a or b for a, b in re.findall(r"\}\s*(\w+)\s*;|\btypedef\s[^;{}]*?(\w+)\s*;", plain)}


def defined_names(text: str) -> set[str]:
    """Names that a kernel file defines for those that include it."""
    code = without_comments(text)
    plain = without_attributes(plain_c(text))
    macros = set(re.findall(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", code, re.M))
    guards = {name for name in macros if re.fullmatch(r"CLGS_\w+_H", name)}
    made = re.findall(r"^DEFINE_\w+\((\w+)", code, re.M)
    return macros - guards | _types(text) | set(_HELPER.findall(plain)) | set(made)


def used_names(text: str) -> set[str]:
    """Identifiers of a kernel file outside of comments, strings, includes and members."""
    code = _INCLUDE.sub("", without_comments(text))
    return set(re.findall(r"(?<![.\w])(?<!->)[A-Za-z_]\w*", code))
