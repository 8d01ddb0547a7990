"""Tables of runs: TOML files, checked; and the table of scenes of ``clgs batch``."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from clgs.cluster.block_plan import parse_counts
from clgs.cluster.worker import Task
from clgs.errors import UsageError
from clgs.train.config import layered
from clgs.train.config.sources import MAX_BYTES, find

NAME = re.compile(r"[A-Za-z0-9][\w.+-]*")

Settings = dict[str, Any]
"""Checked settings of training by name; those of tables are dotted."""


def read_toml(path: Path) -> dict[str, Any]:
    """What is in a TOML file.

    Raises:
        UsageError: no such file, or not TOML.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise UsageError(f"{path}: has more than {MAX_BYTES} bytes; name a table of runs")
        return tomllib.loads(content.decode("utf-8-sig"))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; name a table of runs") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is not UTF-8 text; name a table of runs") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UsageError(f"{path}: not a TOML file: {error}; correct it") from None


def named(table: Mapping[str, Any], kind: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(name, table) of every ``[kind.name]``.

    Raises:
        UsageError: there is none, or one is no table or has no proper name.
    """
    found = table.get(kind)
    if not isinstance(found, dict) or not found:
        raise UsageError(f"{kind}: there is none; write [{kind}.NAME] and its fields")
    for name, one in found.items():
        if not NAME.fullmatch(name):
            raise UsageError(f"{kind}.{name!r}: is no name; give letters, digits, . _ + or -")
        if not isinstance(one, dict):
            raise UsageError(f"{kind}.{name}: is not a table; write [{kind}.{name}]")
        yield name, one


def only(table: Mapping[str, Any], where: str, known: tuple[str, ...]) -> None:
    """Raise UsageError if ``table``, which is at ``where``, has a field that is not ``known``."""
    for name in table:
        if name not in known:
            raise UsageError(f"{where}: no field {name!r}; it may have {', '.join(known)}")


def checked(values: Any, where: str) -> Settings:
    """The settings of training that a table gives.

    Raises:
        UsageError: no table, an unknown name, or a value of the wrong type or range.
    """
    if not isinstance(values, dict):
        raise UsageError(f"{where}: is not a table of settings")
    try:
        return {name: find(name).check(value) for name, value in values.items()}
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def read_scenes(path: Path, output: Path) -> list[Task]:
    """The scenes of a table, each with ``data``, perhaps ``settings`` and ``blocks``, as tasks.

    ``[settings]`` are those of every scene; a scene's own count more. Folders of data are relative
    to that of the table. A task has run (the scene's name), data, folder (``output``/NAME), lock
    (paths), blocks (NxM or None) and settings.

    Raises:
        UsageError: no such file, not TOML, or a name or value that cannot be; names where.
    """
    table = read_toml(path)
    try:
        only(table, "the table", ("settings", "scene"))
        shared = checked(table.get("settings", {}), "settings")
        return [
            {
                "run": name,
                "data": str((path.parent / _data(name, one)).resolve()),
                "folder": str((output / name).resolve()),
                "lock": str((output / "locks" / name).resolve()),
                "blocks": _blocks(name, one),
                "settings": _settings(name, one, shared),
            }
            for name, one in named(table, "scene")
        ]
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _data(name: str, one: Mapping[str, Any]) -> str:
    only(one, f"scene.{name}", ("data", "settings", "blocks"))
    data = one.get("data")
    if not isinstance(data, str) or not data or "\0" in data:
        raise UsageError(f"scene.{name}.data: give the folder of the data set")
    if name in ("kernels", "locks"):
        raise UsageError(f"scene.{name}: the folder of runs has one of this name; rename it")
    return data


def _blocks(name: str, one: Mapping[str, Any]) -> str | None:
    blocks = one.get("blocks")
    try:
        if blocks is not None and parse_counts(str(blocks)) is None:
            raise UsageError("a table cannot ask what memory is free; give NxM")
    except UsageError as error:
        raise UsageError(f"scene.{name}.blocks: {error}") from None
    return blocks


def _settings(name: str, one: Mapping[str, Any], shared: Settings) -> Settings:
    settings = shared | checked(one.get("settings", {}), f"scene.{name}.settings")
    try:
        layered(settings)
    except UsageError as error:
        raise UsageError(f"scene.{name}: {error}") from None
    return settings
