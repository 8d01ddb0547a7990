"""Unfinished folders are removed if their process is killed, or by the next run."""

import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from clgs.errors import DataError
from clgs.files import atomic_folder
from clgs.poses.pycolmap_child import CrashError
from clgs.poses.unfinished import (
    HINT,
    OWNER,
    digest_of,
    kept_pieces,
    owned,
    remove_leftovers,
    removed_if_killed,
)

PROCESS = """
import subprocess, sys
from pathlib import Path
from clgs.poses.unfinished import removed_if_killed
folder = Path(sys.argv[1])
folder.mkdir()
with removed_if_killed(folder):
    (folder / "below").mkdir()
    (folder / "below" / "file").touch()
    pipe = subprocess.PIPE
    other = subprocess.Popen([sys.executable, "-c", sys.argv[2], str(folder)], stdout=pipe)
    other.stdout.readline()
    print("made", flush=True)
    sys.stdin.read()
"""
WRITES_ON = """
import os, sys, time
print("writing", flush=True)
end = time.monotonic() + 1.0  # longer than the one who began it lives
while time.monotonic() < end:
    os.makedirs(os.path.join(sys.argv[1], "late"), exist_ok=True)
"""
HANG = 60
"""Seconds after which the clean-up is given up."""


@pytest.mark.slow
@pytest.mark.parametrize("other", ["", WRITES_ON])
def test_a_killed_process_leaves_nothing(tmp_path: Path, other: str):
    folder = tmp_path / "made"
    command = [sys.executable, "-c", PROCESS, str(folder), other]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "made\n"
        assert (folder / "below" / "file").exists()
        process.kill()
    end = time.monotonic() + HANG
    gone = 0
    while gone < 20 and time.monotonic() < end:  # the other process makes it again for a second
        gone = 0 if folder.exists() else gone + 1
        time.sleep(0.1)
    assert not folder.exists()


KEEPS = """
import sys
from pathlib import Path
from clgs.poses.unfinished import kept_pieces, removed_if_killed
output = Path(sys.argv[1])
with kept_pieces(output, "one") as kept, removed_if_killed(output, kept):
    output.mkdir()
    print("made", flush=True)
    sys.stdin.read()
"""


def test_the_guard_of_a_killed_process_leaves_the_next_one_its_pieces(tmp_path: Path):
    output, pipe = tmp_path / "data", subprocess.PIPE
    command = [sys.executable, "-c", KEEPS, str(output)]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "made\n"
        process.kill()
    with kept_pieces(output, "one") as kept:
        end = time.monotonic() + HANG
        while output.exists() and time.monotonic() < end:  # the guard has begun
            time.sleep(0.01)
        time.sleep(0.5)  # and goes on
        (kept / "01 matches").mkdir()


def test_otherwise_it_stays(tmp_path: Path):
    with removed_if_killed(tmp_path):
        (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="for a reason"), removed_if_killed(tmp_path):
        raise ValueError("for a reason")
    assert (tmp_path / "file").exists()


def test_what_a_killed_run_left_is_removed(tmp_path: Path):
    with atomic_folder(tmp_path / "data") as made:
        left = made.with_name(made.name.translate(str.maketrans("0123", "3210")))
    (tmp_path / "data").rmdir()
    other = tmp_path / left.name.replace("data", "other")
    for folder in (left, other):
        (folder / "work").mkdir(parents=True)
        (folder / "work" / OWNER).touch()
    mine = tmp_path / ".data.my_notes"
    mine.mkdir()
    running = tmp_path / f".data.{76543210:018}"
    running.mkdir()
    with owned(running / "work"):
        remove_leftovers(tmp_path / "data")
        assert sorted(tmp_path.iterdir()) == sorted([other, mine, running])


def stop(output: Path, digest: str, error: BaseException, *made: str) -> set[str]:
    """Make folders of pieces, and end by an error; returns the names that were there before."""
    with suppress(type(error)), kept_pieces(output, digest) as kept:
        found = {path.name for path in kept.iterdir()} - {".owner"}
        with kept_pieces(output, digest) as other:  # of a process that works next to it
            assert other is None
        for name in made:
            (kept / name).mkdir()
        raise error
    return found


def test_finished_pieces_stay_for_the_same_input_alone(tmp_path: Path):
    output, stopped = tmp_path / "data", KeyboardInterrupt()
    assert not stop(output, "one", stopped, "01 matches", ".02 poses.0123")
    assert stopped.__notes__ == [HINT]
    assert stop(output, "one", CrashError("killed")) == {"01 matches"}
    with kept_pieces(output, "one"):
        assert not stop(output, "two", KeyboardInterrupt())
        assert [path.name for path in tmp_path.iterdir()] == [".data.unfinished-one"]
    assert not list(tmp_path.iterdir())
    stop(output, "one", OSError(28, "No space left on device"), "01 matches")
    assert not stop(output, "two", KeyboardInterrupt())
    assert not list(tmp_path.iterdir())  # nothing of the other was finished


@pytest.mark.parametrize("error", [DataError("no two photos could be related"), ValueError("bug")])
def test_finished_pieces_go_once_the_photos_are_at_fault(tmp_path: Path, error: Exception):
    stop(tmp_path / "data", "one", error, "01 matches")
    assert bool(list(tmp_path.iterdir())) == isinstance(error, ValueError)


def test_a_digest_tells_photos_and_options_apart(tmp_path: Path):
    photo = tmp_path / "a.png"
    photo.write_bytes(b"1234")
    os.utime(photo, (1, 1))
    first = digest_of([photo], [0])
    assert digest_of([photo], [1]) != first
    os.utime(photo, (2, 2))
    assert digest_of([photo], [0]) != first
    os.utime(photo, (1, 1))
    assert digest_of([photo], [0]) == first
    assert digest_of([photo.rename(tmp_path / "b.png")], [0]) != first
