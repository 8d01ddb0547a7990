"""Lines on standard error: each in one piece, even if Python does not buffer."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from clgs.cli.tell import tell

PROGRAM = "from clgs.cli.tell import tell; tell('one'); tell('two')"


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no sockets that keep writes apart")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_line_is_one_write(unbuffered: str):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        command = [sys.executable, "-c", PROGRAM]
        subprocess.run(command, env=environment, stderr=theirs, check=True)
        ours.settimeout(0)
        assert [ours.recv(100), ours.recv(100)] == [b"one\n", b"two\n"]


def test_a_closed_standard_error_is_no_error(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr(sys, "stderr", None)
    tell("nobody hears this")
    assert capsys.readouterr().out == ""
