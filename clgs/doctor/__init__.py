"""What ``clgs doctor`` finds."""

from __future__ import annotations

from dataclasses import dataclass

ERROR, WARNING, NOTE = "error", "warning", "note"
LEVELS = (ERROR, WARNING, NOTE)
"""An error stops clgs or spoils its result, a warning may spoil it, a note is good to know."""

NAMED = 6
"""A finding names at most this many of the things that have its fault."""


@dataclass(frozen=True)
class Finding:
    """One fault or fact: its level, the thing concerned, the problem, and what to do."""

    level: str
    where: str
    problem: str
    remedy: str


def named(names: list[str]) -> str:
    """The first of the names, and how many there are if those are not all."""
    shown = [name[-80:] if name.isprintable() else repr(name[-80:]) for name in names[:NAMED]]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(shown) + more


def errors_first(findings: list[Finding]) -> list[Finding]:
    """The findings by level: errors, warnings, notes."""
    return sorted(findings, key=lambda finding: LEVELS.index(finding.level))


def from_error(error: Exception) -> Finding:
    """The finding for an error of clgs, whose remedy follows the last semicolon."""
    text = " ".join(str(error).split())
    problem, mark, remedy = text.rpartition("; ")
    return Finding(ERROR, "", problem if mark else text, remedy if mark else "correct it")
