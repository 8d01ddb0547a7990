"""Figures to compare with: points of another state of clgs, and published ones."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clgs.errors import DataError

PUBLISHED = Path(__file__).with_name("published.toml")
MAX_BYTES = 64 << 20
"""A larger file holds no results."""

REMEDY = "give the results.json of another state"


@dataclass(frozen=True)
class Point:
    """A run of another state; ``experiment`` is empty if the file does not tell."""

    scene: str
    experiment: str
    steps: int | None
    bytes: float
    psnr: float


def read_baseline(path: Path) -> list[Point]:
    """The points in a ``results.json``: a row has scene, bytes, psnr, perhaps experiment and steps.

    Raises:
        DataError: the file is missing, or no such file; names the row and the field.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path}: has more than {MAX_BYTES} bytes; {REMEDY}")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}; {REMEDY}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not UTF-8 text; {REMEDY}") from None
    try:
        rows = json.loads(text)["rows"]
    except (ValueError, RecursionError, KeyError, TypeError):
        raise DataError(f"{path}: is no JSON object with a field 'rows'; {REMEDY}") from None
    if not isinstance(rows, list):
        raise DataError(f"{path}: rows: is not a list; {REMEDY}")
    found = [_point(f"{path}: row {number}", row) for number, row in enumerate(rows, 1)]
    if not found:
        raise DataError(f"{path}: has no rows; {REMEDY}")
    return found


def _point(where: str, row: Any) -> Point:
    if not isinstance(row, dict):
        raise DataError(f"{where}: is not an object; {REMEDY}")
    scene, experiment = row.get("scene"), row.get("experiment") or ""
    if not isinstance(scene, str) or not isinstance(experiment, str) or not scene:
        raise DataError(f"{where}: scene: is missing or no name; {REMEDY}")
    size, psnr = (_number(where, name, row.get(name)) for name in ("bytes", "psnr"))
    if size <= 0:
        raise DataError(f"{where}: bytes: {size:g} is no size of a file; {REMEDY}")
    steps = row.get("steps")
    whole = None if steps in (None, "") else int(_number(where, "steps", steps))
    return Point(scene, experiment, whole, size, psnr)


def _number(where: str, name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{where}: {name}: {value!r} is no finite number; {REMEDY}")
    return number


def read_published() -> dict[str, Any]:
    """The figures of other methods, ``published.toml``."""
    return tomllib.loads(PUBLISHED.read_text(encoding="utf-8"))
