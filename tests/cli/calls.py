"""A command in this process, as all tests of refusals call it."""

from collections.abc import Sequence

from clgs.cli.main import main


def exit_code(words: Sequence[str]) -> int:
    """The exit code of a command, whether the command or its parser ends it."""
    try:
        return main(words)
    except SystemExit as stop:
        return int(stop.code or 0)
