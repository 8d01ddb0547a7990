"""Interruptions that come in the middle of an import wait for its end."""

import importlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from unittest.mock import Mock

import pytest

from clgs.cli.interruptions import Interruptions
from tests.terminal import as_from_a_terminal

INTERRUPTED = "import signal\nexec('signal.raise_signal(signal.{})')\ndone = True\n"
"""``python -m`` would end by the signal itself: an exception left a text that ``exec`` runs."""

PROGRAM = """
import clgs.cli.main as cli
cli._run = lambda argv: __import__("interrupted_module").forever()
raise SystemExit(cli.main([]))
"""


@pytest.fixture
def write_module(tmp_path, monkeypatch):
    """Write a module of this text, which can be imported for as long as the test runs."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(text: str) -> str:
        (tmp_path / "interrupted_module.py").write_text(text)
        importlib.invalidate_caches()
        return "interrupted_module"

    yield write
    sys.modules.pop("interrupted_module", None)


@pytest.fixture(autouse=True)
def _handlers():
    usual = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def within(*functions: Callable[[], object]) -> None:
    """Call them one after the other in a block."""
    with Interruptions():
        for function in functions:
            function()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_an_import_ends_before_the_interruption(write_module, name):
    module = write_module(INTERRUPTED.format(name))
    reached: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        within(
            lambda: importlib.import_module(module),
            lambda: reached.append("imported"),
            lambda: time.sleep(60),  # it wakes
            lambda: reached.append("woke by itself"),
        )
    assert reached == ["imported"]
    assert sys.modules[module].done


@pytest.mark.parametrize("times", [1, 2], ids=["comes at the end of the block", "does not wait"])
def test_an_interruption_that_still_waits_and_a_second_one(write_module, monkeypatch, times):
    monkeypatch.setattr("clgs.cli.interruptions.LATER", 60)
    module = write_module(times * INTERRUPTED.format("SIGINT"))
    with pytest.raises(KeyboardInterrupt):
        within(lambda: importlib.import_module(module))
    assert (module in sys.modules) == (times == 1)
    assert times == 2 or sys.modules[module].done


def test_a_module_that_runs_a_command_as_it_is_imported_can_be_interrupted(write_module):
    text = (
        "import signal\nfrom clgs.cli.interruptions import Interruptions\n"
        "with Interruptions():\n    signal.raise_signal(signal.SIGTERM)\n    assert False\n"
    )
    with pytest.raises(KeyboardInterrupt):
        importlib.import_module(write_module(text))


def test_handlers_of_the_caller_and_ignored_signals_stay(monkeypatch):
    seen: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
    for handler in (signal.SIG_IGN, signal.getsignal(signal.SIGINT)):
        signal.signal(signal.SIGHUP, handler)
        with Interruptions():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGHUP)
    assert seen == [signal.SIGINT, signal.SIGINT, signal.SIGHUP]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.skipif(os.name == "nt", reason="no such signals")
def test_ignored_signals_do_not_reach_handlers_that_a_compiler_sets():
    seen: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Interruptions():
        signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
        signal.raise_signal(signal.SIGINT)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    assert not seen
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_an_interruption_is_not_lost_if_no_thread_starts(write_module, monkeypatch):
    fail = Mock(side_effect=RuntimeError("can't start new thread"))
    monkeypatch.setattr("clgs.cli.interruptions._thread.start_new_thread", fail)
    module = write_module(INTERRUPTED.format("SIGINT"))
    with pytest.raises(KeyboardInterrupt):
        within(lambda: importlib.import_module(module))


def test_an_error_of_the_block_is_raised_and_not_the_interruption(write_module, monkeypatch):
    monkeypatch.setattr("clgs.cli.interruptions.LATER", 60)
    module = write_module(INTERRUPTED.format("SIGINT"))
    with pytest.raises(ValueError, match="first"):
        within(lambda: importlib.import_module(module), lambda: int("first"))


def test_exit_code_of_an_interruption_within_an_import(tmp_path):
    text = INTERRUPTED.format("SIGINT") + "def forever():\n    import time\n    time.sleep(60)\n"
    (tmp_path / "interrupted_module.py").write_text(text)
    (tmp_path / "program.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, "-m", "program"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=as_from_a_terminal,
        check=False,
    )
    assert (done.returncode, done.stderr) == (130, "clgs: interrupted\n")
