"""Programs are built in a child process before this process builds them for the first time.

A driver's compiler may end the process that calls it. Then the child is gone, and the user reads
one line. What was built is noted in the user's cache folder, in a file per device, driver and
version of clgs, so that later starts ask no child. Drivers and pyopencl keep what they build, so
that the second build, by this process, takes little time.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
import weakref
from contextlib import suppress
from typing import Any

import pyopencl as cl

from clgs import __version__
from clgs.errors import DeviceError
from clgs.files import cache_folder
from clgs.opencl.choose import is_emulator, list_devices, serves_cpu_form

IDLE_SECONDS = 20.0
"""A child without work ends itself after this time, since it takes memory of the device."""


class FirstBuilds:
    """Tries the programs of one device in a child process, unless they were built before."""

    def __init__(self, cl_device: Any) -> None:
        """``cl_device``: pyopencl's. Nothing is tried before it is asked for."""
        self._device = cl_device
        self._name = str(cl_device.name).strip()
        platform = cl_device.platform
        given = [__version__, self._name, cl_device.driver_version, platform.name, platform.version]
        self._notes = cache_folder() / "drivers" / f"{_digest(*given)}.txt"
        self._built: set[str] | None = None
        self._child: _Child | None = None
        # An emulator keeps nothing that it builds, and two drivers are known to build everything.
        self._needed = not (is_emulator(cl_device) or serves_cpu_form(cl_device))

    def try_build(self, file: str, source: str, options: list[str]) -> float:
        """Build a program in the child if it is new here; returns the child's processor seconds.

        A program with errors is no problem here: this process meets them again, as exceptions.

        Args:
            file: of the program, for messages.
            source: of the program, includes expanded.
            options: of the build.

        Raises:
            DeviceError: the driver ended the child.
        """
        if self._built is None:
            self._built = set()
            with suppress(OSError):
                self._built |= set(self._notes.read_text("ascii", "replace").split())
        key = _digest(source, *options)
        if not self._needed or key in self._built:
            return 0.0
        seconds = self._ask(file, json.dumps({"source": source, "options": options}))
        if seconds is None:
            self._needed = False
            return 0.0
        self._built.add(key)
        with suppress(OSError):
            self._notes.parent.mkdir(parents=True, exist_ok=True)
            with self._notes.open("a", encoding="ascii") as notes:
                notes.write(f"{key}\n")
        return seconds

    def _ask(self, file: str, work: str) -> float | None:
        """Let a child build; returns its seconds, None if no child can be had."""
        for _ in range(2):  # the first may be about to end for want of work
            if self._child is None:
                try:
                    self._child = _Child(list_devices().index(self._device))
                except (OSError, ValueError):
                    return None
                weakref.finalize(self, self._child.end)
            seconds = self._child.build(work)
            if seconds is not None:
                return seconds
            started, at, (code, said) = self._child.started, self._child.at, self._child.end()
            self._child = None
            if not started:
                return None
            if code:
                how = f"signal {-code}" if code < 0 else f"exit code {code}"
                raise DeviceError(
                    f"the driver of {self._name} ends the process that builds kernels_cl/{file}"
                    f"{at and f', at kernel {at}'} ({how}{said and f': {said}'}); "
                    "update the driver, or choose another device with --device"
                )
        return None


class _Child:
    """A process that builds what it is sent.

    started: whether it came so far as to have the device. at: the kernel that it makes, if any.
    """

    def __init__(self, index: int) -> None:
        """``index``: of the device, in the list of :func:`list_devices`."""
        program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        self.started, self.at = False, ""
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by end()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", program, str(index), str(IDLE_SECONDS)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                text=True,
                start_new_session=True,  # Ctrl-C in a terminal reaches this process alone
            )
        except OSError:
            self._said.close()
            raise
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._work, self._answers = self._process.stdin, self._process.stdout

    def build(self, work: str) -> float | None:
        """The seconds that it took; None if the process ended."""
        self.at = ""
        with suppress(BrokenPipeError, OSError):
            self._work.write(f"{work}\n")
            self._work.flush()
        try:
            for line in self._answers:
                kind, value = json.loads(line)
                if kind == "built":
                    return float(value)
                self.started, self.at = True, value
        except BaseException:  # an interruption does not wait for the driver
            self._process.kill()
            raise
        return None

    def end(self) -> tuple[int, str]:
        """Let the process end; returns its exit code and the last line that it said."""
        if self._said.closed:
            return 0, ""
        with suppress(BrokenPipeError, OSError):
            self._work.close()
        code = self._process.wait()
        self._answers.close()
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").split("\n")
        self._said.close()
        return code, next((line.strip()[:200] for line in reversed(lines) if line.strip()), "")


def serve() -> None:
    """Be the child: build programs, one per line of the standard input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a driver prints must not be read as an answer

    def answer(kind: str, value: Any) -> None:
        print(json.dumps([kind, value]), file=answers, flush=True)

    context = cl.Context([list_devices()[int(sys.argv[1])]])
    answer("kernel", "")
    while True:
        idle = threading.Timer(float(sys.argv[2]), os._exit, (0,))
        idle.daemon = True
        idle.start()
        line = sys.stdin.readline()
        idle.cancel()
        if not line:
            os._exit(0)  # at once: drivers may take long to end, and even crash
        work, start = json.loads(line), time.thread_time()
        with warnings.catch_warnings(), suppress(cl.Error):
            warnings.simplefilter("ignore")
            program = cl.Program(context, work["source"]).build(work["options"])
            for name in program.kernel_names.split(";"):
                answer("kernel", name)
                cl.Kernel(program, name)
        answer("built", time.thread_time() - start)


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:32]
