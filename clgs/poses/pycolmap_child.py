"""pycolmap: imported only if it is needed, and its work in a child process.

Native code that works for minutes reacts to a signal only at its next pause. A child process can be
ended at once, its memory is freed with it, and its crash becomes an ordinary error. pycolmap is
kept quiet, and its failures are one line.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

import PIL.Image  # noqa: F401 - only the order of the imports matters

from clgs.errors import DataError
from clgs.machine import return_freed_memory

# Pillow must be loaded before pycolmap. In the other order Pillow's PNG writer calls the zlib of
# pycolmap and corrupts the heap (seen with pycolmap 4.2.1 and Pillow 13).


SEEDS = 2**31
"""The number of seeds that pycolmap accepts; larger seeds are reduced modulo this."""

_FATAL_ONLY = 3
"""glog severity: information, warnings and errors are not printed."""


@contextmanager
def quiet_pycolmap(task: str) -> Iterator[Any]:
    """Import pycolmap and keep it quiet; its exceptions become a DataError that names ``task``.

    Raises:
        DataError: pycolmap is not installed, or fails.
    """
    pycolmap = _load(task)
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL_ONLY
    try:
        yield pycolmap
    except DataError:
        raise
    # C++ code and pybind11 raise many types; every one of them means that the task failed.
    except Exception as error:
        raise DataError(f"{task}: {' '.join(str(error).split())[-200:]}") from error
    finally:
        pycolmap.logging.minloglevel = before


def _load(task: str) -> Any:
    try:
        with _handlers_kept():
            import pycolmap
    except ModuleNotFoundError as error:
        raise DataError(
            f"{task}: pycolmap is missing; pip install pycolmap, or use a machine that it has a "
            "wheel for and copy the result"
        ) from error
    # pycolmap turns an ImportError of its C++ part into a RuntimeError.
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise DataError(
            f"{task}: pycolmap cannot be loaded ({reason}); install it again"
        ) from error
    return pycolmap


@contextmanager
def _handlers_kept() -> Iterator[None]:
    """Delay signals within the block; after it the former handlers receive them.

    pycolmap's C++ part installs handlers that end the process with a native stack trace. An
    exception that a handler raises during its import would come out as a different one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    before = {number: handler for number, handler in found.items() if handler is not None}
    seen: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        seen.append(number)

    for number in before:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for arrived in seen:
        signal.raise_signal(arrived)


OnStage = Callable[[Any], None]
"""The type of a function that receives a child's reports of progress; they can be JSON."""


class CrashError(DataError):
    """A child process ended by itself: nothing is known of the data."""


ERRORS = {"error": DataError, "crash": CrashError}
"""What a child writes, and what its parent raises."""

IMPORT_SECONDS = 60
"""An import that takes longer counts as failed."""

_serving: list[bool] = []
"""Holds one element in a child process; the children of a child belong to its session."""

_running: list[subprocess.Popen[str]] = []


def run_child(module: str, task: str, arguments: Any, on_stage: OnStage) -> Any:
    """Run ``work(arguments, on_stage)`` of a module in a child process; returns its result.

    Arguments, results and reports of progress pass as JSON; messages name the ``task``.

    Raises:
        DataError: the work failed.
        CrashError: the child, or one of its own, crashed or was killed.
    """
    program = (
        f"import sys; sys.path[:] = {sys.path!r}; from clgs.poses.pycolmap_child import serve; "
        f"from {module} import work; serve(work)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=not _serving,  # so that Ctrl-C in a terminal reaches this process alone
    ) as child:
        _running.append(child)
        try:
            assert child.stdin is not None
            assert child.stdout is not None
            with suppress(BrokenPipeError):
                child.stdin.write(json.dumps(arguments) + "\n")
                child.stdin.flush()
            for line in child.stdout:
                kind, value = json.loads(line)
                if kind == "result":
                    return value
                if kind in ERRORS:
                    raise ERRORS[kind](value)
                on_stage(value)
            exit_code = child.wait()
            if problem := import_problem("pycolmap"):  # then the data is not at fault
                raise DataError(f"{task}: pycolmap cannot be loaded ({problem}); install it again")
            if os.name != "nt" and exit_code == -signal.SIGKILL:  # Windows has no such signal
                raise CrashError(f"{task}: pycolmap was killed; see if there is enough memory")
            raise CrashError(f"{task}: pycolmap crashed (exit code {exit_code}); try other photos")
        except BaseException:
            if _serving or os.name == "nt":
                child.kill()
            else:  # with the children that it has
                with suppress(ProcessLookupError):
                    os.killpg(child.pid, signal.SIGKILL)
            raise
        finally:
            _running.remove(child)


def serve(work: Callable[[Any, OnStage], Any]) -> None:
    """Be the child: read arguments from the standard input, write the result to standard output.

    The child ends if its parent does, and so do its own children.
    """
    return_freed_memory()
    _serving.append(True)
    answers = os.dup(1)
    os.dup2(2, 1)  # what a library prints must not be read as a result
    given = sys.stdin.readline()
    if not given:  # the parent was interrupted before it wrote the arguments
        return
    arguments = json.loads(given)

    def end_with_parent() -> None:
        sys.stdin.read()  # returns if the parent has ended
        for child in list(_running):
            child.kill()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    one_at_a_time = threading.Lock()

    def write(kind: str, value: Any) -> None:
        with one_at_a_time, open(answers, "w", closefd=False) as output:
            print(json.dumps([kind, value]), file=output)

    try:
        result = work(arguments, lambda stage: write("stage", stage))
    except DataError as error:
        write("crash" if isinstance(error, CrashError) else "error", str(error))
    else:
        write("result", result)


def import_problem(module: str) -> str:
    """Try to import ``module`` in another process, since a native module may abort.

    Returns:
        Why the import fails, in a few words; empty if it works.
    """
    # Pillow first, as before every import of pycolmap.
    code = f"import sys; sys.path[:] = {sys.path!r}; import PIL.Image; import {module}"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=IMPORT_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"its import takes more than {IMPORT_SECONDS} s"
    if done.returncode < 0:
        return f"its import ends by signal {-done.returncode}"
    if done.returncode:
        lines = done.stderr.decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "unknown error")
    return ""
