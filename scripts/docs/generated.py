"""Pages of the documentation that are made from the code: commands and training options."""

from __future__ import annotations

import argparse
import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields

SPECIAL = re.compile(r"([\\*_<>\[\]|#])")
"""What Markdown would read as markup in the text of a help message."""

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
    parts += [_command(child, level + 1) for child in _children(parser)]
    return "\n\n".join(part for part in parts if part)


def _options(parser: argparse.ArgumentParser) -> str:
    """A table of the arguments and options; that of `--help` alone is left out."""
    formatter = parser._get_formatter()
    rows = []
    for action in parser._actions:
        if action.help is argparse.SUPPRESS or isinstance(
            action, argparse._HelpAction | argparse._SubParsersAction
        ):
            continue
        text = formatter._expand_help(action) if action.help else ""
        need = "required" if action.option_strings and action.required else ""
        choices = ", ".join(f"`{choice}`" for choice in action.choices or ())
        notes = [part for part in (need, _escape(text), choices) if part]
        rows.append((_names(action), "; ".join(notes)))
    return _table(("argument", "meaning"), rows) if rows else ""


def _names(action: argparse.Action) -> str:
    value = action.metavar or (action.dest if not action.option_strings else action.dest.upper())
    value = " ".join(value) if isinstance(value, tuple) else value
    if not action.option_strings:
        return f"`{value}`"
    words = ", ".join(f"`{name}`" for name in action.option_strings)
    return words if action.nargs == 0 or action.choices else f"{words} `{value}`"


def training_options() -> str:
    """Every setting of a training run: a table in the order of ``TrainConfig``, as Markdown."""
    from clgs.train import config

    head = ("setting", "default", "meaning")
    rows = _settings(config.TrainConfig, "") + _settings(config.LearningRates, "learning_rates.")
    return _table(head, rows)


def _settings(kind: type, prefix: str) -> list[tuple[str, str, str]]:
    """(name, default, help) of the fields of a data class that have a plain default."""
    texts = _field_docstrings(kind)
    rows = []
    for field in fields(kind):
        if isinstance(field.default, bool | int | float | str | tuple | None):
            default = "none" if field.default is None else f"`{field.default}`"
            help_text = _escape(" ".join(texts.get(field.name, "").split()))
            rows.append((f"`{prefix}{field.name}`", default, help_text))
    return rows


def _field_docstrings(kind: type) -> dict[str, str]:
    """The string that stands below each field of a data class, by the field's name."""
    body = ast.parse(inspect.getsource(kind)).body[0]
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, text in zip(body.body, body.body[1:], strict=False):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            texts[field.target.id] = str(text.value.value)
    return texts


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
