"""Processes exchange built kernels, whole files only."""

import os
from unittest.mock import Mock

import pytest

from tests.kernel_cache import UNUSED, KernelCache, remove_unused

BUILD = "AB/CDEF/scan_apply/64-1-1/scan_apply.so"


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.fixture
def caches(tmp_path):
    return [KernelCache(tmp_path / "common", tmp_path / name) for name in ("one", "other")]


@pytest.mark.parametrize("file_systems", [1, 2])
def test_what_one_has_built_the_other_takes(caches, monkeypatch, file_systems):
    if file_systems == 2:
        no_link = OSError("Invalid cross-device link")
        monkeypatch.setattr(os, "link", Mock(side_effect=no_link))
    one, other = caches
    write(one.own, BUILD, "first")
    write(one.own, "AB/CDEF/program.bc", "program")
    write(one.own, "tempfile_x1.so", "half written")
    one.give()
    other.take()
    assert (other.own / BUILD).read_text() == "first"
    assert len(list((other.own / BUILD).parent.iterdir())) == 1
    assert len([path for path in other.own.rglob("*") if path.is_file()]) == 2


def test_the_first_build_stays(caches):
    one, other = caches
    for cache, text in ((one, "first"), (other, "second")):
        write(cache.own, BUILD, text)
        cache.give()
    one.take()
    assert [(c.own / BUILD).read_text() for c in caches] == ["first", "second"]
    assert (one.common / BUILD).read_text() == "first"


def test_what_nobody_uses_is_removed(tmp_path):
    for name, age in (("AB/OLD", UNUSED + 60), ("AB/NEW", UNUSED - 60)):
        stamp = write(tmp_path, f"{name}/last_accessed", "")
        used = stamp.stat().st_mtime - age
        os.utime(stamp, (used, used))
    remove_unused(tmp_path)
    assert [path.name for path in (tmp_path / "AB").iterdir()] == ["NEW"]
