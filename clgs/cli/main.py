"""The ``clgs`` command: parse arguments, run a subcommand, turn errors into one line and a code.

Exit codes: 0 success, 1 failure, 2 usage, 3 data, 4 device, 130 interrupted.
"""

from __future__ import annotations

import codecs
import importlib
import io
import os
import shlex
import sys
import warnings
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

from clgs import __version__
from clgs.cli.interruptions import Interruptions
from clgs.cli.tell import tell
from clgs.errors import ClgsError, explain

if TYPE_CHECKING:
    import argparse

COMMANDS = {
    "run": "photos to scene, report, page and video in one go",
    "devices": "list the OpenCL devices and the one that is used",
    "doctor": "say what is wrong with a data set or with this machine",
    "prepare": "find the camera poses of a folder of photos, or of a video",
    "train": "train a scene from photos with poses",
    "batch": "train the scenes of a table, side by side or on many machines",
    "encode": "compress a trained scene into one .clgs file",
    "decode": "decompress a .clgs file into a NumPy archive",
    "crop": "keep a part of a trained scene, without training",
    "pack": "compress an ordinary 3DGS PLY file",
    "unpack": "decompress what `clgs pack` made into a PLY file",
    "render": "render views or a clip of a scene",
    "view": "look at a scene in the browser",
    "eval": "PSNR, SSIM and LPIPS against the photos",
    "export": "write a scene or a data set for other programs",
    "info": "show what a .clgs file holds",
    "selftest": "check every kernel against float64 on every device",
    "bench": "measure speed and accuracy on this device",
    "conformance": "compare the bits of devices",
    "accept": "try everything on a device, for a report",
}
"""Every command and its line in ``clgs --help``."""

LABORATORY = ("selftest", "bench", "conformance", "accept")
"""The commands that are modules of ``clgs.lab.commands``; all others are in ``clgs.cli.commands``.

A module has ``register(parser)``, which adds the options, and ``run(args)``, which returns the exit
code. It is imported only if its command is the one that runs.
"""

EPILOG = """\
exit codes: 0 success, 1 failure, 2 usage, 3 data, 4 device, 130 interrupted

An output that exists is replaced with --overwrite alone.

Environment: PYOPENCL_CTX chooses a device as --device does; CLGS_DEBUG=1 shows tracebacks."""


def build_parser(commands: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The parser of ``clgs``, which knows the names of all commands and the options of some.

    Args:
        commands: those whose modules are imported and whose options are added; default: all.
    """
    from clgs.cli.parser import EXAMPLES, SHELLS, Completion, Parser, epilog

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
    for command, line in COMMANDS.items():
        child = subparsers.add_parser(command, help=line)
        if command in commands:
            command_module(command).register(child)
            child.epilog = epilog(command) if command in EXAMPLES else None
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that ``argv`` names (default: the process's arguments); its exit code."""
    show_all_letters()
    try:
        with Interruptions(), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: tell(
                f"clgs: warning: {' '.join(str(message).split())}"
            )
            warnings.filterwarnings("ignore", module=r"PIL\.")  # EXIF of cameras is often odd
            code = _run(argv)
        if sys.stdout is not None:  # closed by the caller: `clgs info scene.clgs >&-`
            sys.stdout.flush()
    except KeyboardInterrupt as error:
        tell(f"clgs: interrupted{error}")  # a command may say how to go on
        return 130
    except BrokenPipeError:
        # The reader went away, as in `clgs devices | head -1`: keep Python from complaining later.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return complain(error)
    return code


def show_all_letters() -> None:
    """Print letters that the output's encoding lacks with backslashes: a path may hold any.

    Bytes of a name that are no letters go out as they came in, if Python's locale lets them.
    """
    codecs.register_error("clgs", _bytes_or_backslashes)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            kept = stream.errors == "surrogateescape"
            stream.reconfigure(errors="clgs" if kept else "backslashreplace")


def _bytes_or_backslashes(error: UnicodeError) -> tuple[str | bytes, int]:
    try:
        return codecs.lookup_error("surrogateescape")(error)
    except UnicodeEncodeError:
        return codecs.backslashreplace_errors(error)


def _run(argv: Sequence[str] | None) -> int:
    if "_ARGCOMPLETE" in os.environ:  # the script of --completion asks
        import argcomplete

        command = os.environ.get("COMP_LINE", "").split()[1:2]
        argcomplete.autocomplete(build_parser(command), always_complete_options="long")
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    args = build_parser(words[:1]).parse_args(words)
    args.command_line = shlex.join(["clgs", *words])
    import logging

    logging.basicConfig(format="clgs: warning: %(message)s", level=logging.WARNING)
    if sys.stderr is not None and sys.stderr.isatty():
        from clgs.cli.tell import show_notes

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
    """The module of a command."""
    return importlib.import_module(
        f"clgs.{'lab' if command in LABORATORY else 'cli'}.commands.{command}"
    )


def _lacked_memory(error: BaseException | None) -> bool:
    """Whether memory was short: clean-up that fails then, or a thread's start, may hide it."""
    while error is not None and not isinstance(error, ClgsError | OSError):
        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def complain(error: Exception) -> int:
    """Say what went wrong, in one line and one more for each note; the exit code."""
    if os.environ.get("CLGS_DEBUG"):
        import traceback

        traceback.print_exception(error)
    message, code = explain(error)
    notes = getattr(error, "__notes__", None) or getattr(error.__cause__, "__notes__", [])
    for line in (message, *notes):
        tell(f"clgs: error: {' '.join(line.split())}")
    return code
