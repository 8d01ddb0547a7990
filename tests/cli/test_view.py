"""`clgs view` in a process of its own: it says its address, answers there, and ends."""

import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import numpy as np
import pytest

from clgs.scene.storage import save_scene
from tests.codec.scenes import random_scene
from tests.small_scene import write_scene

pytest.importorskip("viser", reason="needs clgs[view]")


PORT = 18090
"""Is taken, so that the viewer takes the next."""


@pytest.mark.slow
def test_the_viewer_says_where_it_is_and_ends_when_interrupted(tmp_path):
    save_scene(tmp_path / "s.npz", random_scene(np.random.default_rng(3), 40))
    write_scene(tmp_path / "data", train=4, test=1, size=16)
    words = [tmp_path / "s.npz", "--data", tmp_path / "data", "--port", str(PORT)]
    command = [sys.executable, "-m", "clgs", "view", *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with (
        socket.create_server(("127.0.0.1", PORT)),
        subprocess.Popen(command, text=True, **pipes) as process,
    ):
        try:
            address, _, rest = process.stdout.readline().partition("  ")
            assert "Ctrl-C" in rest, process.stderr.read() if process.poll() is not None else ""
            with urllib.request.urlopen(address, timeout=60) as answer:
                assert b"<html" in answer.read().lower()
            place, _, token = address.rstrip("/").rpartition("/")
            assert len(token) == 16
            for other, headers in ((place, {}), (address, {"Host": "evil.example"})):
                request = urllib.request.Request(other, headers=headers)
                with pytest.raises(urllib.error.HTTPError, match="403"):
                    urllib.request.urlopen(request, timeout=60)
        finally:
            process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"port {PORT} is taken" in said
    assert f":{PORT}/" not in address
    assert "interrupted" in said
    assert "Traceback" not in said
