"""Lines on standard error: each in one piece, even if Python does not buffer."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.cli.tell import tell
from clgs.codec.scene_encoder import encode
from clgs.codec.splat_packing import QuantizedSplats, pack
from tests.codec.scenes import random_scene
from tests.small_scene import write_scene

PROGRAM = "from clgs.cli.tell import tell; tell('one'); tell('two')"


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no sockets that keep writes apart")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_line_is_one_write(unbuffered):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        command = [sys.executable, "-c", PROGRAM]
        subprocess.run(command, env=environment, stderr=theirs, check=True)
        ours.settimeout(0)
        assert [ours.recv(100), ours.recv(100)] == [b"one\n", b"two\n"]


def test_a_closed_standard_error_is_no_error(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", None)
    tell("nobody hears this")
    assert capsys.readouterr().out == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "encoding"),
    [
        *(("info", one) for one in ("cp1252", "latin-1", "ascii", "utf-8")),
        *(("info", "ascii:surrogateescape"), ("doctor", "ascii:surrogateescape")),
        *(("decode", "cp1252"), ("unpack", "cp1252"), ("doctor", "cp1252")),
    ],
)
def test_a_path_of_any_letters_is_printed(command, encoding, tmp_path):
    """Letters that the encoding lacks become backslashes, also those of no encoding at all."""
    folder = tmp_path / os.fsdecode(b"\xd0\xb6\xff\xe4\xbd\xa0")
    folder.mkdir()
    (folder / "s.clgs").write_bytes(encode(random_scene(np.random.default_rng(3), 40)))
    splats = QuantizedSplats(["x", "y", "z", "a"], [1.0] * 4, np.zeros((1, 4), np.int32))
    (folder / "p.clgs").write_bytes(pack(splats))
    write_scene(folder, train=4, test=1, size=16)
    words: dict[str, list[object]] = {
        "info": [folder / "none"],
        "decode": [folder / "s.clgs", "-o", folder / "s.npz"],
        "unpack": [folder / "p.clgs", "-o", folder / "p.ply"],
        "doctor": [folder],
    }
    done = subprocess.run(
        [sys.executable, "-m", "clgs", command, *map(str, words[command])],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        capture_output=True,
        check=False,
    )
    said = done.stderr + done.stdout
    assert done.returncode == (3 if command == "info" else 0), said
    assert b"Traceback" not in said
    assert b"bug" not in said
    known = {"utf-8": "\u0436".encode()}.get(encoding, b"\\u0436")
    assert known in said


@pytest.mark.slow
def test_a_run_in_a_folder_of_any_name_has_its_pages(tmp_path, monkeypatch, capsys):
    """Bytes that are no letters cannot be written as UTF-8: pages show backslashes as well."""
    monkeypatch.setattr("clgs.data.points.HULL_POINTS", 3000)  # for speed
    folder = tmp_path / os.fsdecode(b"\xff<b>")
    words = [write_scene(folder / "data", train=6, test=2), "-o", folder / "out", "--steps", 2]
    assert main(["run", *map(str, words), "--clip", "none"]) == 0
    for name in ("report.html", "scene.html", "run/report.html"):
        page = (folder / "out" / name).read_text(encoding="utf-8")
        assert "<title>\\udcff&lt;b&gt;</title>" in page
