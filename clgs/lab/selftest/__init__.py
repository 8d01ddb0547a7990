"""Checks of every stage against its reference, and hashes of everything that stages compute."""

from __future__ import annotations

from pathlib import Path

SHIPPED = Path(__file__).with_name("conformance.json")
"""The hashes that come with clgs, made by PoCL 3.1 on a CPU."""
