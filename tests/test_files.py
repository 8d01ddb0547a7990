"""Files and folders appear completely or not at all."""

import io
import os
import re
import signal
import stat
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from clgs.errors import ExistsError, OutputError, UsageError
from clgs.files import (
    append,
    atomic_folder,
    atomic_path,
    atomic_write,
    atomic_write_all,
    check_folder,
    check_output,
    folder_to_fill,
    make_folder,
    remove_abandoned,
    remove_temporaries,
)


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
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        atomic_write(tmp_path / "x", b"data")
    assert names(tmp_path) == []


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(OutputError, match="make it first"):
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
        with pytest.raises(OutputError, match="exists and is n"):
            atomic_folder(tmp_path / name).__enter__()
    assert names(tmp_path) == ["file", "run"]


def test_what_appeared_meanwhile_is_not_overwritten(tmp_path):
    target = tmp_path / "run"

    def make():
        with atomic_folder(target) as folder:
            (folder / "slow").touch()
            target.mkdir()
            (target / "fast").touch()

    with pytest.raises(ExistsError, match="add --overwrite"):
        make()
    assert names(tmp_path) == ["run"]
    assert names(target) == ["fast"]


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "real.bin").write_bytes(b"old")
    for name in ("real.bin", "new.bin"):
        link = tmp_path / f"to_{name}"
        link.symlink_to(tmp_path / "elsewhere" / name)
        atomic_write(link, b"new")
        assert link.is_symlink()
        assert (tmp_path / "elsewhere" / name).read_bytes() == b"new"
    assert names(tmp_path / "elsewhere") == ["new.bin", "real.bin"]


@pytest.mark.parametrize("linked", [False, True])
def test_a_device_is_not_replaced(tmp_path, linked):
    path = tmp_path / "null" if linked else Path(os.devnull)
    if linked:
        path.symlink_to(os.devnull)
    with pytest.raises(OutputError, match="not a regular file"):
        atomic_write(path, b"data")
    assert not Path(os.devnull).is_file()


def test_errors_name_the_path_and_the_remedy(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "ring").symlink_to("ring")
    cases = [
        *(("missing/x", "there is no folder .* make it first"), (".", "is a folder; name a file")),
        *(("x" * 256, "choose another name"), ("ring", "choose another name")),
        ("file/x", "there is no folder .*/file; choose another name"),
    ]
    for name, remedy in cases:
        with pytest.raises(OutputError, match=f"^{re.escape(str(tmp_path / name))}: .*{remedy}$"):
            atomic_write(tmp_path / name, b"data")
    with pytest.raises(OutputError, match=r"/missing/run: .* make it first$"):
        atomic_folder(tmp_path / "missing" / "run").__enter__()
    assert names(tmp_path) == ["file", "ring"]


def test_a_bad_name_is_wrong_usage_and_an_error_of_the_system():
    assert OutputError.exit_code == UsageError.exit_code == 2
    assert issubclass(OutputError, OSError)
    assert str(OutputError("x: is a folder")) == "x: is a folder"


def test_no_permission_is_one_error_for_files_and_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    no_permission = pytest.raises(OutputError, match=r"no permission in .*; choose another folder")
    with no_permission:
        atomic_write(tmp_path / "x", b"data")
    with no_permission:
        check_folder(tmp_path / "x" / "y")
    with no_permission, atomic_folder(tmp_path / "x"):
        pass


def test_a_folder_is_replaced_only_if_asked_for_and_only_by_a_whole_one(tmp_path):
    target = tmp_path / "data"
    target.mkdir()
    (target / "old").touch()
    with pytest.raises(ExistsError, match="add --overwrite"), atomic_folder(target):
        pass
    with pytest.raises(FileNotFoundError), atomic_folder(target, overwrite=True) as folder:
        (folder / "half" / "x").touch()
    assert names(target) == ["old"]
    with atomic_folder(target, overwrite=True) as folder:
        (folder / "new").touch()
    assert names(target) == ["new"]
    assert names(tmp_path) == ["data"]


def test_errors_of_the_temporary_file_name_the_path(tmp_path):
    with pytest.raises(FileNotFoundError) as caught, atomic_path(tmp_path / "x.png"):
        pass
    assert caught.value.filename == str(tmp_path / "x.png")
    with pytest.raises(FileNotFoundError) as caught, atomic_folder(tmp_path / "run") as folder:
        (folder / "inner" / "x").touch()
    assert caught.value.filename == str(tmp_path / "run" / "inner" / "x")


def test_names_may_be_as_long_as_the_folder_allows(tmp_path):
    name = "x" * 251 + ".bin"
    atomic_write(tmp_path / name, b"data")
    assert names(tmp_path) == [name]


def test_what_a_killed_process_began_to_write_is_removed(tmp_path):
    with atomic_path(tmp_path / "clip.mp4") as temporary:
        temporary.touch()
        kept = ["clip.mp4", ".clip.mp4", ".clip.0123456.mp4", ".clips.01234567.mp4"]
        for name in kept:
            (tmp_path / name).touch()
        remove_temporaries(tmp_path / "clip.mp4")
        assert names(tmp_path) == sorted(kept)
        temporary.touch()


def test_a_link_to_a_missing_folder_makes_it(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    make_folder(tmp_path / "link")
    make_folder(tmp_path / "link")
    assert (tmp_path / "far" / "away").is_dir()


def test_a_folder_that_cannot_be_made_is_wrong_usage(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/folder: cannot be made \(.*\); choose another"):
        make_folder(tmp_path / "file" / "folder")


def test_folders_are_checked_before_they_are_made(tmp_path):
    check_folder(tmp_path / "new" / "deeper")
    (tmp_path / "file").touch()
    for name in ("file", "file/deeper"):
        with pytest.raises(OutputError, match="is no folder"):
            check_folder(tmp_path / name)


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("call", ["replace", "fsync"])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_several_files_are_written_or_none(tmp_path, monkeypatch, links, call, number):
    contents = {tmp_path / "a": b"new a", tmp_path / "b": b"new b", tmp_path / "c": b"new c"}
    (tmp_path / "b").write_bytes(b"old b")
    (tmp_path / "elsewhere").write_bytes(b"old c")
    (tmp_path / "c").symlink_to("elsewhere")
    whole, calls = getattr(os, call), []

    def fail_once(*arguments):
        calls.append(arguments)
        if len(calls) == number:
            raise OSError(28, "No space left on device")
        return whole(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(os, call, fail_once)
        if not links:
            patch.setattr(os, "link", Mock(side_effect=OSError(1, "Operation not permitted")))
        with pytest.raises(OSError, match="No space left"):
            atomic_write_all(contents)
    assert names(tmp_path) == ["b", "c", "elsewhere"]
    assert [(tmp_path / name).read_bytes() for name in "bc"] == [b"old b", b"old c"]
    atomic_write_all(contents)
    assert names(tmp_path) == ["a", "b", "c", "elsewhere"]
    assert {path: path.read_bytes() for path in contents} == contents
    assert (tmp_path / "c").is_symlink()


def test_an_output_is_no_input(tmp_path):
    source, other = tmp_path / "a", tmp_path / "b"
    source.touch()
    check_output(other, source, tmp_path / "none")
    other.symlink_to(source)
    for output in (source, other, tmp_path / "." / "a"):
        with pytest.raises(UsageError, match="is read by this command; choose another output"):
            check_output(output, tmp_path / "none", source)
    with pytest.raises(OutputError, match="is a folder"):
        check_output(tmp_path, source)


def test_what_cannot_be_added_whole_is_not_added(tmp_path, monkeypatch):
    """The disk has room for a part."""
    path = tmp_path / "log"
    append(path, b"one\n")

    class Part(io.FileIO):
        def write(self, data):
            if len(data) < 4:
                raise OSError(28, "No space left on device")
            return super().write(data[:2])

    monkeypatch.setattr(Path, "open", lambda path, mode, buffering: Part(path, mode))
    with pytest.raises(OSError, match=r"No space left on device: .*log"):
        append(path, b"two\nthree\n")
    monkeypatch.undo()
    append(path, b"four\n")
    assert path.read_bytes() == b"one\nfour\n"


def fail_in(folder, filled):
    with folder_to_fill(folder):
        if filled:
            (folder / "picture.png").touch()
        raise OSError("disk")


def test_a_folder_that_stays_empty_is_removed_on_a_failure(tmp_path):
    (tmp_path / "old").mkdir()
    for name in ("new", "old", "full"):
        with pytest.raises(OSError, match="disk"):
            fail_in(tmp_path / name, name == "full")
    assert names(tmp_path) == ["full", "old"]
    with folder_to_fill(tmp_path / "new"):
        assert names(tmp_path) == ["full", "new", "old"]
    assert names(tmp_path) == ["full", "new", "old"]


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot tell whether a process lives")
def test_files_of_a_killed_process_are_removed_and_no_others(tmp_path):
    code = f"""
import os, signal
from pathlib import Path
from clgs.files import atomic_path
with atomic_path(Path({str(tmp_path / "frame.png")!r})) as temporary:
    temporary.touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    with atomic_path(tmp_path / "own.json") as own:
        own.touch()
        number, tag = own.stem[-18:-12], own.stem[-12:-8]
    other = "0001" if tag == "0000" else "0000"  # as of a process that had the same number
    (tmp_path / f".a.{number}{other}01234567.png").touch()
    kept = {".mine.png", ".a.cafe.png", "x.0badcafe.png", left.with_suffix(".json").name}
    for name in kept:
        (tmp_path / name).touch()
    with atomic_path(tmp_path / "other.png") as temporary:
        temporary.touch()
        remove_abandoned.cache_clear()
        remove_abandoned(tmp_path, ".png")
        assert set(names(tmp_path)) == {*kept, temporary.name, "own.json"}
