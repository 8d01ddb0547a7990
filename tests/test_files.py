"""Files and folders appear completely or not at all."""

from __future__ import annotations

import os
import stat

import pytest

from clgs.files import atomic_folder, atomic_path, atomic_write


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_write_replaces_the_old_file(tmp_path):
    for data in (b"old", b"", b"new" * 1000):
        atomic_write(tmp_path / "x.bin", data)
        assert (tmp_path / "x.bin").read_bytes() == data
    assert names(tmp_path) == ["x.bin"]


def test_new_files_get_the_usual_permissions(tmp_path):
    atomic_write(tmp_path / "x", b"1")
    (tmp_path / "y").write_bytes(b"1")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in "xy"]
    assert modes[0] == modes[1]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, error):
    target = tmp_path / "x.png"
    target.write_bytes(b"old")

    def fail():
        with atomic_path(target) as temporary:
            assert (temporary.parent, temporary.suffix) == (tmp_path, ".png")
            temporary.write_bytes(b"half")
            raise error

    with pytest.raises(error):
        fail()
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["x.png"]


def test_a_writer_that_writes_nothing_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "x"):
        pass
    assert names(tmp_path) == []


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        atomic_write(tmp_path / "x", b"data")
    assert names(tmp_path) == []


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        atomic_write(tmp_path / "missing" / "x", b"data")


@pytest.mark.parametrize("exists", [False, True])
def test_a_folder_appears_whole(tmp_path, exists):
    target = tmp_path / "run"
    if exists:
        target.mkdir()
    with atomic_folder(target) as temporary:
        (temporary / "inner").mkdir()
        (temporary / "inner" / "x").write_bytes(b"1")
        assert names(tmp_path) == sorted([temporary.name, *(["run"] if exists else [])])
    assert names(tmp_path) == ["run"]
    assert (target / "inner" / "x").read_bytes() == b"1"


def test_a_failed_folder_is_removed(tmp_path):
    def fail():
        with atomic_folder(tmp_path / "run") as temporary:
            (temporary / "x").write_bytes(b"1")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert names(tmp_path) == []


def test_a_full_folder_and_a_file_are_not_overwritten(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine").write_bytes(b"1")
    (tmp_path / "file").write_bytes(b"2")
    for name in ("run", "file"):
        with pytest.raises(FileExistsError, match="not an empty folder"):
            atomic_folder(tmp_path / name).__enter__()
    assert names(tmp_path) == ["file", "run"]
