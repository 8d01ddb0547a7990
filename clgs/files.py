"""Write files and folders completely or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from clgs.errors import ExistsError, OutputError, UsageError, is_full

_TAG = os.urandom(2).hex()
"""Tells this process from one that was killed and had the same number, as in containers."""

STEM_KEPT = 48
"""Characters of a name that its temporary name keeps: it must not grow too long for a folder."""


LIKELY_FOR_A_BYTE, SMALL = 64, 1 << 24
"""Numbers that mean something expand less. This many bytes are read in any case."""


def check_declared(declared: int, size: int) -> None:
    """Raise ValueError if ``size`` bytes declare more than they are likely to hold."""
    if declared > max(LIKELY_FOR_A_BYTE * size, SMALL):
        raise ValueError(f"{size:,} bytes that declare arrays of {declared:,} bytes")


def in_any_case(path: Path) -> Path:
    """``path``, or, if it is not there, the only file next to it that differs in capitals alone."""
    if path.exists() or not path.parent.is_dir():
        return path
    alike = [file for file in path.parent.iterdir() if file.name.lower() == path.name.lower()]
    return alike[0] if len(alike) == 1 else path


def atomic_write(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path``: readers see the old file or the whole new one.

    Raises:
        OutputError: as of :func:`check_target`.
        OSError: ``path`` cannot be written, or the disk is full; nothing is left.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def text_bytes(text: str) -> bytes:
    """``text`` in UTF-8; bytes of file names that are no letters become backslashes."""
    return text.encode(errors="backslashreplace")


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` as indented JSON, as :func:`atomic_write` does."""
    atomic_write(path, (json.dumps(value, indent=1) + "\n").encode())


def atomic_write_all(contents: dict[Path, bytes]) -> None:
    """Write several files: all of them, or none.

    All are on the disk before the first takes its name; the first of ``contents`` takes its name
    last. If one cannot, the others become again what they were.

    Raises:
        OutputError, OSError: as of :func:`atomic_write`.
    """
    with ExitStack() as stack:
        for path in contents:
            stack.enter_context(_put_back(path))
        for path, data in contents.items():
            temporary = stack.enter_context(atomic_path(path))
            temporary.write_bytes(data)
            _sync(temporary)


def append(path: Path, data: bytes) -> None:
    """Add ``data`` at the end of ``path``, all of it or nothing.

    Raises:
        OSError: ``path`` cannot be written, or the disk is full.
    """
    with _blamed_on(path, path), path.open("ab", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        try:
            while data:
                data = data[file.write(data) or 0 :]
        except BaseException:
            with suppress(OSError):
                file.truncate(size)
            raise


def check_output(path: Path, *sources: Path) -> None:
    """Check ``path`` as :func:`check_target` does; UsageError if it is one of ``sources``.

    A link to a source is refused too.
    """
    check_target(path)
    for source in sources:
        if path.exists() and source.exists() and path.samefile(source):
            raise UsageError(f"{path}: is read by this command; choose another output")


def check_target(path: Path) -> Path:
    """The file that writing to ``path`` makes or replaces: links are followed.

    Call it before long work whose result goes to ``path``.

    Raises:
        OutputError: the folder is missing, ``path`` is a folder, a device or another thing that is
            no regular file, the name is none (too long, links in a circle), or the folder is not
            writable.
    """
    mode = _mode(path)
    if stat.S_ISDIR(mode):
        raise OutputError(f"{path}: is a folder; name a file")
    if not stat.S_ISREG(mode):
        raise OutputError(f"{path}: is not a regular file; name another")
    target = Path(os.path.realpath(path))
    _check_parent(path, target.parent)
    return target


def _mode(path: Path) -> int:
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return stat.S_IFREG
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}; choose another name") from None


def make_folder(path: Path) -> None:
    """Make the folder ``path``, and those above that are missing; links are followed.

    Raises:
        OutputError: it cannot be made.
    """
    try:
        Path(os.path.realpath(path)).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if is_full(error):
            raise
        problem = f"cannot be made ({error.strerror}); choose another folder"
        raise OutputError(f"{path}: {problem}") from None


@contextmanager
def folder_to_fill(path: Path) -> Iterator[None]:
    """Make the folder ``path``; if the block fails, a folder that is new and empty is removed."""
    new = not path.exists()
    make_folder(path)
    try:
        yield
    except BaseException:
        if new:
            with suppress(OSError):
                path.rmdir()
        raise


def check_folder(path: Path) -> None:
    """Raise OutputError if ``path`` is, or lies in, what is no folder or may not be written to.

    Folders that are missing can be made, and are no error.
    """
    _mode(path)
    nearest = next((folder for folder in (path, *path.parents) if folder.exists()), None)
    if nearest and not nearest.is_dir():
        raise OutputError(f"{nearest}: is no folder; choose another name")
    if nearest:
        _check_writable(path, nearest)


def _check_parent(path: Path, parent: Path) -> None:
    if not parent.is_dir():
        remedy = "choose another name" if parent.exists() else "make it first"
        raise OutputError(f"{path}: cannot be written: there is no folder {parent}; {remedy}")
    _check_writable(path, parent)


def _check_writable(path: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        problem = f"cannot be written: no permission in {folder}; choose another folder"
        raise OutputError(f"{path}: {problem}")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A path next to ``path`` to write one file to; it takes the name ``path`` on success.

    The temporary name keeps the suffix, because many writers choose the format by it. If ``path``
    is a link, the file that it names is written. On any failure the temporary file is
    removed and ``path`` stays as it was.

    Raises:
        OutputError, OSError: as :func:`atomic_write`; those of the temporary file name ``path``.
    """
    path = Path(path)
    target = check_target(path)
    remove_abandoned(target.parent, path.suffix)
    temporary = _temporary(path, target.parent)
    try:
        with _blamed_on(path, temporary):
            yield temporary
            _sync(temporary)
            os.replace(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    _sync_folder(target.parent)


@contextmanager
def _put_back(path: Path) -> Iterator[None]:
    """On a failure, ``path`` is again the file that it was, or none."""
    target = check_target(path)
    existed, old = target.exists(), _temporary(path, target.parent)
    try:
        if existed:
            try:
                os.link(target, old)
            except OSError:  # the file system has no hard links
                shutil.copy2(target, old)
        yield
    except BaseException:
        with suppress(OSError):
            os.replace(old, target) if existed else target.unlink()
        raise
    finally:
        with suppress(OSError):
            old.unlink()


@contextmanager
def atomic_folder(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """A new folder next to ``path`` to fill; it takes the name ``path`` on success.

    On any failure it is removed with all that it holds, and what was at ``path`` is there still.

    Raises:
        ExistsError: ``path`` is a file, or without ``overwrite`` a folder that is not empty.
        OutputError: its parent is missing, or not writable.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise ExistsError(f"{path}: exists and is no folder; choose another")
    _check_free(path, overwrite)
    target = Path(os.path.realpath(path))
    _check_parent(path, target.parent)
    temporary = _temporary(path, target.parent)
    try:
        with _blamed_on(path, temporary):
            temporary.mkdir()
            yield temporary
            for entry in temporary.rglob("*"):
                _sync_folder(entry) if entry.is_dir() else _sync(entry)
            _sync_folder(temporary)
            _check_free(path, overwrite)  # another process may have been faster
            _take_name(temporary, target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    _sync_folder(target.parent)


def _check_free(path: Path, overwrite: bool) -> None:
    """Raise ExistsError if ``path`` is a folder that holds something, and may not be replaced."""
    if path.exists() and not overwrite and any(path.iterdir()):
        raise ExistsError(
            f"{path}: exists and is not an empty folder; add --overwrite or choose another"
        )


def _take_name(folder: Path, target: Path) -> None:
    """Rename ``folder`` to ``target``; a folder of that name is removed afterwards."""
    if not target.exists():
        folder.rename(target)
        return
    old = _temporary(target, target.parent)
    target.rename(old)
    try:
        folder.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old)


def remove_temporaries(path: Path) -> None:
    """Remove what killed processes began to write to ``path``; none may be writing to it now."""
    for left in path.parent.glob(f".{path.stem[:STEM_KEPT]}.{'?' * 18}{path.suffix}"):
        left.unlink(missing_ok=True)


@cache
def remove_abandoned(folder: Path, suffix: str) -> None:
    """Remove files of ``suffix`` that processes which are gone began to write in ``folder``.

    Looks once per process: a folder may hold many files. A process on another machine that writes
    to the same folder counts as gone.
    """
    if os.name == "nt" or not folder.is_dir():  # Windows has no signal that only asks
        return
    for left in folder.glob(".*"):
        found = re.fullmatch(r"\..+\.([0-9a-f]{6})([0-9a-f]{4})[0-9a-f]{8}", left.stem)
        if found and left.suffix == suffix and left.is_file() and not _is_alive(*found.groups()):
            left.unlink(missing_ok=True)


def _is_alive(number: str, tag: str) -> bool:
    """Whether there is a process with this number, hexadecimal, and if it is this one this tag."""
    if int(number, 16) == os.getpid() & 0xFFFFFF:
        return tag == _TAG
    try:
        os.kill(int(number, 16), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _temporary(path: Path, folder: Path) -> Path:
    """A new name, which holds the number of the process and its tag."""
    own = f"{os.getpid() & 0xFFFFFF:06x}{_TAG}{os.urandom(4).hex()}"
    return folder / f".{path.stem[:STEM_KEPT]}.{own}{path.suffix}"


@contextmanager
def _blamed_on(path: Path, temporary: Path) -> Iterator[None]:
    """Let an OSError that names ``temporary`` or no file name ``path``, which the user knows."""
    try:
        yield
    except OSError as error:
        name = "" if error.filename is None else str(error.filename)
        if error.errno is not None and (not name or name.startswith(str(temporary))):
            error.filename = f"{path}{name.removeprefix(str(temporary))}"
        raise


def _sync(path: Path) -> None:
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    """Make renames in a folder durable; Windows has no such call and needs none."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def cache_folder() -> Path:
    """Where what can be made again is kept: CLGS_CACHE, else clgs in the user's cache folder."""
    if chosen := os.environ.get("CLGS_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "clgs"
