"""Pages of the documentation that are made from the code: commands and training options."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Iterator
from itertools import groupby

SPECIAL = re.compile(r"([\\*_<>\[\]|#])")
"""What Markdown would read as markup in the text of a help message."""

STANDARD_GROUPS = ("positional arguments", "options")
"""Titles that argparse itself gives."""

CODE = re.compile(r"(`[^`]+`|(?<![\w-])--[a-z][a-z-]*)")
"""What is code in such a text: what stands between backticks, and options."""


def commands() -> str:
    """Every command with its usage, description and options, as Markdown."""
    from clgs.cli.main import build_parser

    return "\n\n".join(_command(child, 2) for child in _children(build_parser()))


def _children(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.values()


def _command(parser: argparse.ArgumentParser, level: int) -> str:
    text = re.sub(r"\n(--[a-z-]+:)", r"\n\n\1", parser.description or "")  # a paragraph per option
    parts = [f"{'#' * level} {parser.prog}", _escape(text)]
    parts += [_code(parser.format_usage()), _options(parser)]
    if parser.epilog:
        head, _, lines = parser.epilog.partition("\n")
        parts += [head.capitalize(), _code(textwrap.dedent(lines))]
    parts += [_command(child, level + 1) for child in _children(parser)]
    return "\n\n".join(part for part in parts if part)


def _options(parser: argparse.ArgumentParser) -> str:
    """A table of the arguments and options, and one per further group; `--help` is left out."""
    formatter = parser._get_formatter()
    tables: dict[str, list[tuple[str, ...]]] = {}
    for group in parser._action_groups:
        title = "" if group.title in STANDARD_GROUPS else f"**{group.title}**\n\n"
        for action in group._group_actions:
            if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
                text = formatter._expand_help(action) if action.help else ""
                row = _names(action), _meaning(action, text)
                tables.setdefault(title, []).append(row)
    head = ("argument", "meaning")
    return "\n\n".join(f"{title}{_table(head, rows)}" for title, rows in tables.items())


def _meaning(action: argparse.Action, text: str) -> str:
    need = "required" if action.option_strings and action.required else ""
    choices = ", ".join(f"`{choice}`" for choice in action.choices or ())
    return "; ".join(part for part in (need, _escape(text), choices) if part)


def _names(action: argparse.Action) -> str:
    value = action.metavar or (action.dest if not action.option_strings else action.dest.upper())
    value = " ".join(value) if isinstance(value, tuple) else value
    if not action.option_strings:
        return f"`{value}`"
    words = ", ".join(f"`{name}`" for name in action.option_strings)
    return words if action.nargs == 0 or action.choices else f"{words} `{value}`"


def training_options() -> str:
    """Every setting of a training run, a table under the heading of each group, as Markdown."""
    from clgs.train.config import TrainConfig, options_of

    parts = []
    for group, rows in groupby(options_of(TrainConfig).values(), lambda row: row.group):
        cells = []
        for row in rows:
            unit = "" if row.unit == "none" else row.unit
            default = f"`{row.default_text}`" if row.default_text else "none"
            cells.append((f"`{row.name}`", default, unit, _escape(row.range), _escape(row.help)))
        parts.append(f"## {group.capitalize()}")
        parts.append(_table(("setting", "default", "unit", "range", "meaning"), cells))
    return "\n\n".join(parts)


def _code(text: str) -> str:
    return f"```text\n{text.removeprefix('usage: ').strip()}\n```"


def _escape(text: str) -> str:
    """``text`` as Markdown: its special characters escaped, options between backticks."""
    parts = CODE.split(text)
    return "".join(
        f"`{p.strip('`')}`" if i % 2 else SPECIAL.sub(r"\\\1", p) for i, p in enumerate(parts)
    )


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
