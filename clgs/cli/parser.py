"""The argument parser of ``clgs`` and of each of its commands."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any


class Parser(argparse.ArgumentParser):
    """A parser that itself refuses what it does not know, so that its own usage is shown.

    The standard one of a command hands such arguments back to that of ``clgs``.
    """

    def parse_known_args(  # type: ignore[override]  # one form of its four
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As of the base class; nothing is ever left over."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown
