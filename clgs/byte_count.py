"""Numbers of bytes as people write them: 800k, 1.5M."""

from __future__ import annotations

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9}

MOST = 2**63


def byte_count(text: str) -> int | None:
    """A number, and k, M or G for 10^3, 10^6 or 10^9 of them; None if ``text`` is no such size."""
    text = text.strip()
    number, unit = (text[:-1], text[-1].lower()) if text[-1:].isalpha() else (text, "")
    try:
        value = float(number) * UNITS[unit]
    except (ValueError, KeyError):
        return None
    return int(value) if 1 <= value < MOST else None
