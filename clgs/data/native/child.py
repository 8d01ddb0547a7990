"""Work of pycolmap in a process of its own.

Native code that works for minutes hears of a signal only at its next pause; a process beside ends
at once, its memory goes with it, and a crash of it is an error like others.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from clgs.data.native.probe import import_problem
from clgs.errors import DataError
from clgs.memory import return_freed_memory

OnStage = Callable[[Any], None]
"""Called with whatever a process tells of its progress, ready for JSON."""


def run_child(
    module: str,
    task: str,
    arguments: Any,
    on_stage: OnStage,
    remedy: str = "try other photos",
) -> Any:
    """What ``main()`` of a module, which calls :func:`serve`, makes of ``arguments``.

    Args:
        module: its dotted name.
        task: what it does, for messages.
        arguments: ready for JSON; the result comes as JSON, too.
        on_stage: called with what the process says of its progress.
        remedy: what to do if it crashes.

    Raises:
        DataError: the work failed, or the process crashed.
    """
    code = f"import sys; sys.path[:] = {sys.path!r}; from {module} import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=not _serving,  # Ctrl-C in a terminal comes to this process alone
    ) as child:
        _running.append(child)
        try:
            return _follow(child, arguments, on_stage, task, remedy)
        except BaseException:
            _kill(child)
            raise
        finally:
            _running.remove(child)


_serving: list[bool] = []
"""Holds one element in a process that serves; its own children belong to its session."""

_running: list[subprocess.Popen[str]] = []


def _kill(child: subprocess.Popen[str]) -> None:
    """End a child, and the children that it has."""
    if _serving or os.name == "nt":
        child.kill()
        return
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)


def _follow(
    child: subprocess.Popen[str], arguments: Any, on_stage: OnStage, task: str, remedy: str
) -> Any:
    """Hand over the arguments, pass on the stages, return the result."""
    assert child.stdin is not None
    assert child.stdout is not None
    with suppress(BrokenPipeError):
        child.stdin.write(json.dumps(arguments) + "\n")
        child.stdin.flush()
    for line in child.stdout:
        kind, value = json.loads(line)
        if kind == "result":
            return value
        if kind == "error":
            raise DataError(value)
        on_stage(value)
    raise DataError(_crash(task, child.wait(), remedy))


def _crash(task: str, code: int, remedy: str) -> str:
    """What to say of a child that crashed: of the data, unless pycolmap never worked here."""
    if problem := import_problem("pycolmap"):
        return f"{task}: pycolmap cannot be loaded ({problem}); install it again"
    return f"{task}: pycolmap crashed (exit code {code}); {remedy}"


def serve(work: Callable[[Any, OnStage], Any]) -> None:
    """The process: arguments from the standard input, results to the standard output.

    It ends if its parent does, and so do its own children.
    """
    return_freed_memory()
    _serving.append(True)
    output = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever a library prints is no result
    given = sys.stdin.readline()
    if not given:  # the parent was interrupted before it said what to do
        return
    arguments = json.loads(given)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    one_at_a_time = threading.Lock()

    def say(kind: str, value: Any) -> None:
        with one_at_a_time:
            print(json.dumps([kind, value]), file=output, flush=True)

    try:
        result = work(arguments, lambda stage: say("stage", stage))
    except DataError as error:
        say("error", str(error))
    else:
        say("result", result)


def _end_with_parent() -> None:
    """Ends this process if its standard input ends, that is, if the parent has ended."""
    sys.stdin.read()
    for child in list(_running):
        child.kill()
    os._exit(1)
