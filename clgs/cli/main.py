"""The ``clgs`` command: parse arguments, run a subcommand, turn errors into one line and a code.

Exit codes: 0 success, 1 failure, 2 usage, 3 data, 4 device, 130 interrupted.
"""

from __future__ import annotations

import importlib
import os
import shlex
import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from clgs import __version__
from clgs.cli.interruptions import Interruptions
from clgs.cli.tell import tell
from clgs.errors import ClgsError, DeviceError
from clgs.files import is_full

if TYPE_CHECKING:
    import argparse

COMMANDS = {
    **dict.fromkeys(("run", "devices", "doctor", "prepare", "train", "encode", "decode"), "cli"),
    **dict.fromkeys(("pack", "unpack", "render", "view", "eval", "export", "info"), "cli"),
    **dict.fromkeys(("selftest", "bench", "conformance", "accept"), "lab"),
}
"""The package of each: a module of ``clgs.<package>.commands`` with ``register`` and ``run``."""

LOST = ("OUT_OF_RESOURCES", "DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE", "INVALID_CONTEXT")
"""What drivers answer once a device has failed, or is gone."""

EPILOG = """\
exit codes: 0 success, 1 failure, 2 usage, 3 data, 4 device, 130 interrupted

An output that exists is replaced with --overwrite alone.

Environment: PYOPENCL_CTX chooses a device as --device does; CLGS_DEBUG=1 shows tracebacks."""


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands; the commands' heavy imports wait until they run."""
    from clgs.cli.completion import SHELLS, Completion
    from clgs.cli.examples import EXAMPLES, epilog
    from clgs.cli.parser import Parser

    parser = Parser(
        prog="clgs",
        description="Gaussian splatting on OpenCL: from photos to one compressed file and back.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"clgs {__version__}")
    parser.add_argument(
        "--completion",
        action=Completion,
        choices=SHELLS,
        help='print a script for your shell, as in: eval "$(clgs --completion bash)"',
    )
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command_module(command).register(subparsers)
        if command in EXAMPLES:
            subparsers.choices[command].epilog = epilog(command)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that ``argv`` names (default: the process's arguments); its exit code."""
    try:
        return run_command(argv)
    except KeyboardInterrupt as error:
        tell(f"clgs: interrupted{error}")  # a command may say how to go on
        return 130


def run_command(argv: Sequence[str] | None = None) -> int:
    """As :func:`main`, as a part of another command.

    Raises:
        KeyboardInterrupt: it was interrupted; the other command says so.
    """
    try:
        with Interruptions(), warnings.catch_warnings():
            warnings.showwarning = _show_warning
            code = _run(argv)
        if sys.stdout is not None:  # closed by the caller: `clgs info scene.clgs >&-`
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader went away, as in `clgs devices | head -1`: keep Python from complaining later.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _complain(error)
    return code


def _run(argv: Sequence[str] | None) -> int:
    words = list(sys.argv[1:] if argv is None else argv)
    args = build_parser().parse_args(_with_help(words))
    args.command_line = shlex.join(["clgs", *words])
    import logging

    logging.basicConfig(format="clgs: warning: %(message)s", level=logging.WARNING)
    if sys.stderr is not None and sys.stderr.isatty():
        from clgs.cli.notes import show_notes

        show_notes()
    module = command_module(args.command)
    try:
        code: int = module.run(args)
    except Exception as error:
        if not _lacked_memory(error):
            raise
        less = getattr(module, "LESS_MEMORY", "try a larger --downscale")
        raise ClgsError(f"out of memory; {less}") from error
    return code


def command_module(command: str) -> Any:
    """The module of a command, with ``register(subparsers)`` and ``run(args)``."""
    return importlib.import_module(f"clgs.{COMMANDS[command]}.commands.{command}")


def _with_help(words: Sequence[str]) -> list[str]:
    """``help`` and ``help COMMAND`` as the option of that name."""
    return [*words[1:], "--help"] if list(words[:1]) == ["help"] else list(words)


def _lacked_memory(error: BaseException | None) -> bool:
    """Whether memory was short: clean-up that fails then, or a thread's start, may hide it."""
    while error is not None and not isinstance(error, ClgsError | OSError):
        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    tell(f"clgs: warning: {' '.join(str(message).split())}")


def _complain(error: Exception) -> int:
    if os.environ.get("CLGS_DEBUG"):
        import traceback

        traceback.print_exception(error)
    message, code = explain(error)
    tell(f"clgs: error: {' '.join(message.split())}")
    return code


def explain(error: Exception) -> tuple[str, int]:
    """One line for the user and the exit code."""
    if isinstance(error, ClgsError):
        return str(error), error.exit_code
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename is not None else ""
        remedy = "; free space and run it again" if is_full(error) else ""
        return f"{name}{error.strerror or error}{remedy}", ClgsError.exit_code
    if isinstance(error, MemoryError):
        return "out of memory", ClgsError.exit_code
    if isinstance(error, ImportError):
        return _explain_import(error)
    if type(error).__module__.startswith("pyopencl"):
        return _explain_opencl(error), DeviceError.exit_code
    hint = "this is a bug in clgs; CLGS_DEBUG=1 shows where"
    return f"{type(error).__name__}: {error} ({hint})", ClgsError.exit_code


def _explain_opencl(error: Exception) -> str:
    first = (str(error).strip().splitlines() or ["unknown error"])[0]
    if "MemoryError" in type(error).__name__:
        return f"the device is out of memory ({first}); try a larger --downscale"
    if any(code in first for code in LOST):
        return (
            f"the OpenCL device failed or was lost ({first}); run it again, a training with "
            "--resume; if it fails again, `clgs accept` shows where"
        )
    return f"OpenCL: {type(error).__name__}: {first}"


def _explain_import(error: ImportError) -> tuple[str, int]:
    name = error.name or "a library"
    if name.startswith("pyopencl"):
        remedy = "install it: pip install pyopencl"
        return f"pyopencl cannot be loaded ({error}); {remedy}", DeviceError.exit_code
    return f"{name} cannot be loaded ({error}); install clgs again", ClgsError.exit_code


if __name__ == "__main__":
    sys.exit(main())
