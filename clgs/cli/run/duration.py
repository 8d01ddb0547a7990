"""Times on the command line, such as 90s, 5m and 1h."""

from __future__ import annotations

import argparse
import re

UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}
_FORM = re.compile(r"(\d+(?:\.\d+)?)(s|m|h)")


def duration(text: str) -> float:
    """Seconds of an argument that is a time; without a unit it could mean two things."""
    found = _FORM.fullmatch(text.strip().lower())
    seconds = float(found[1]) * UNITS[found[2]] if found else 0.0
    if not 0 < seconds < 1e7:
        raise argparse.ArgumentTypeError(f"{text} is not a time such as 90s, 5m or 1h")
    return seconds


def in_words(seconds: float) -> str:
    """Such as 45 s, 2.5 min or 1.2 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
