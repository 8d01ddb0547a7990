from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from clgs.errors import ClgsError, DataError
from clgs.train.state import checkpoint

DIGEST = "a" * 64
Arrays = dict[str, npt.NDArray[Any]]


def content(step: int) -> tuple[Arrays, dict[str, Any]]:
    rng = np.random.default_rng(step)
    arrays: Arrays = {
        "position": rng.normal(size=(40, 3)).astype(np.float32),
        "first.offset": rng.normal(size=(40, 10, 3)).astype(np.float32),
        "statistics.visits": rng.integers(0, 9, 40).astype(np.int32),
        "empty": np.empty((0, 6), np.float32),
        "scalar": np.array(step, np.int64),
        "special": np.array([np.nan, -0.0, np.inf, 1e-42], np.float32),
    }
    rng.integers(0, 9, dtype=np.int32)
    return arrays, {"step": step, "rng": rng.bit_generator.state, "psnr": 0.1 + 0.2}


def assert_content(found: tuple[Arrays, dict[str, Any]], step: int) -> None:
    arrays, scalars = content(step)
    assert found[1] == scalars
    assert list(found[0]) == list(arrays)
    for name, array in arrays.items():
        assert found[0][name].dtype == array.dtype
        assert found[0][name].shape == array.shape
        assert found[0][name].tobytes() == array.tobytes()
        assert found[0][name].flags.writeable


def save(folder: Path, step: int, digest: str = DIGEST) -> Path:
    return checkpoint.save(folder, *content(step), digest)


def test_round_trip_is_bit_exact(tmp_path):
    path = save(tmp_path / "new" / "folder", 7)
    assert_content(checkpoint.load(path.parent, DIGEST), 7)
    with np.load(path, allow_pickle=False) as plain:  # an ordinary .npz
        np.testing.assert_array_equal(plain["position"], content(7)[0]["position"])


def test_same_content_same_bytes(tmp_path):
    assert save(tmp_path / "a", 3).read_bytes() == save(tmp_path / "b", 3).read_bytes()


def test_strided_and_fortran_arrays(tmp_path):
    arrays: Arrays = {
        "strided": np.arange(20)[::3],
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    }
    checkpoint.save(tmp_path, arrays, {"step": 1}, DIGEST)
    loaded, _ = checkpoint.load(tmp_path, DIGEST)
    for name, array in arrays.items():
        np.testing.assert_array_equal(loaded[name], array)


def test_the_last_two_are_kept(tmp_path):
    (tmp_path / ".step_00000001.dead.npz").write_bytes(b"left by a killed process")
    (tmp_path / "notes.txt").write_text("not ours")
    for step in (100, 200, 300, 400):
        save(tmp_path, step)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["notes.txt", "step_00000300.npz", "step_00000400.npz"]
    assert_content(checkpoint.load(tmp_path, DIGEST), 400)


def test_a_run_that_went_back_drops_later_checkpoints(tmp_path):
    for step in (100, 200):
        save(tmp_path, step)
    save(tmp_path, 150)
    assert [path.stem for path in checkpoint.checkpoints(tmp_path)] == [
        *("step_00000100", "step_00000150"),
    ]
    save(tmp_path, 150)  # again at the same step
    assert len(checkpoint.checkpoints(tmp_path)) == 2


def damaged(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data)))
    if kind == "flip":
        return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
    if kind == "truncate":
        return data[:at]
    return data[:at] + bytes(min(64, len(data) - at)) + data[at + 64 :]


@pytest.mark.parametrize("kind", ["flip", "truncate", "zero"])
def test_damage_never_goes_unnoticed(tmp_path, kind):
    """The newest loads with its own bits or the one before it is used, with a warning."""
    save(tmp_path, 100)
    newest = save(tmp_path, 200)
    data, rng = newest.read_bytes(), np.random.default_rng(0)
    fallbacks = 0
    for _ in range(170):
        newest.write_bytes(damaged(data, kind, rng))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = checkpoint.load(tmp_path, DIGEST)
        # a flip in what zip ignores (dates, attributes) harms nothing
        assert_content(found, 100 if caught else 200)
        assert all("step_00000200.npz: damaged" in str(item.message) for item in caught)
        fallbacks += bool(caught)
    assert fallbacks >= 120


def test_every_byte_of_an_array_is_checked(tmp_path):
    save(tmp_path, 100)
    newest = save(tmp_path, 200)
    data = bytearray(newest.read_bytes())
    start = data.index(content(200)[0]["first.offset"].tobytes())
    for at in (start, start + 2000, start + 4799):
        data[at] ^= 1
        newest.write_bytes(data)
        data[at] ^= 1
        with pytest.warns(UserWarning, match="damaged"):
            assert_content(checkpoint.load(tmp_path, DIGEST), 100)


def test_a_consistent_zip_with_other_arrays_is_noticed(tmp_path):
    """The metadata's own checksums hold even where every CRC of the zip is right."""
    path = save(tmp_path, 5)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["position.npy"] = members["position.npy"].replace(b"'<f4'", b"'>f4'")
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with (
        pytest.warns(UserWarning, match="position differs from its checksum"),
        pytest.raises(DataError, match="its one checkpoint is damaged"),
    ):
        checkpoint.load(tmp_path, DIGEST)


def test_none_usable_is_one_clear_line(tmp_path):
    with pytest.raises(DataError, match="no checkpoint"):
        checkpoint.load(tmp_path, DIGEST)
    with pytest.raises(DataError, match="no checkpoint"):
        checkpoint.load(tmp_path / "missing", DIGEST)
    for step in (1, 2):
        save(tmp_path, step).write_bytes(b"")
    with (
        pytest.warns(UserWarning, match="damaged"),
        pytest.raises(DataError, match="all 2 checkpoints are damaged") as caught,
    ):
        checkpoint.load(tmp_path, DIGEST)
    assert "\n" not in str(caught.value)


def test_another_configuration_is_refused(tmp_path):
    save(tmp_path, 1)
    save(tmp_path, 2, "b" * 64)
    with pytest.raises(DataError, match="was made with other settings or photos"):
        checkpoint.load(tmp_path, DIGEST)


def test_another_format_is_refused(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "FORMAT_VERSION", 2)
        save(tmp_path, 1)
    with pytest.raises(DataError, match="checkpoint format 2, this program reads 1"):
        checkpoint.load(tmp_path, DIGEST)


def test_pickles_are_neither_written_nor_read(tmp_path):
    with pytest.raises((TypeError, ValueError)):
        checkpoint.save(tmp_path, {"x": np.array([{}], object)}, {"step": 1}, DIGEST)
    assert not list(tmp_path.iterdir())
    path = tmp_path / "step_00000001.npz"
    metadata = {
        "version": 1,
        "digest": DIGEST,
        "scalars": {"step": 1},
        "arrays": {"x": {"dtype": "|O", "shape": [1], "crc32": 0}},
    }
    np.savez(path, x=np.array([{}], object))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(checkpoint.METADATA, json.dumps(metadata))
    with (
        pytest.warns(UserWarning, match="pickle"),
        pytest.raises(DataError, match="damaged"),
    ):
        checkpoint.load(tmp_path, DIGEST)


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_leaves_the_previous_one(tmp_path, monkeypatch, call):
    save(tmp_path, 100)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        with pytest.raises(ClgsError, match="No space left on device") as caught:
            save(tmp_path, 200)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["step_00000100.npz"]
    assert_content(checkpoint.load(tmp_path, DIGEST), 100)


@pytest.fixture
def small_disk(tmp_path, monkeypatch):
    """There is room for two checkpoints, with the one that is being written."""
    whole = os.fsync

    def fsync(descriptor: int) -> None:
        if len([path for path in tmp_path.iterdir() if "step_" in path.name]) > 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        whole(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)


@pytest.mark.usefixtures("small_disk")
def test_the_checkpoint_before_the_newest_makes_room(tmp_path):
    for step in (100, 200, 300, 400):
        save(tmp_path, step)
        assert_content(checkpoint.load(tmp_path, DIGEST), step)
    assert [path.stem for path in checkpoint.checkpoints(tmp_path)] == [
        *("step_00000300", "step_00000400"),
    ]


@pytest.mark.usefixtures("small_disk")
def test_what_a_killed_process_left_makes_room(tmp_path):
    save(tmp_path, 100)
    (tmp_path / ".step_00000200.dead.npz").write_bytes(b"left by a killed process")
    save(tmp_path, 200)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.usefixtures("small_disk")
def test_the_only_whole_checkpoint_never_makes_room(tmp_path):
    save(tmp_path, 100)
    save(tmp_path, 200).write_bytes(b"damaged")
    with pytest.raises(ClgsError, match="No space left on device"):
        save(tmp_path, 300)
    with pytest.warns(UserWarning, match="damaged"):
        assert_content(checkpoint.load(tmp_path, DIGEST), 100)


KILLED = """
import sys
from pathlib import Path
import numpy as np
from clgs.train.state import checkpoint
for step in range(10**6):
    arrays = {"x": np.full(300_000, step, np.float32)}
    checkpoint.save(Path(sys.argv[1]), arrays, {"step": step}, "d")
    print(step, flush=True)
"""


@pytest.mark.slow
def test_killed_while_writing(tmp_path):
    """What the killed process had reported as saved is there, or something later."""
    for wait in range(4):
        with subprocess.Popen(
            [sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            lines = [process.stdout.readline() for _ in range(3 + 5 * wait)]
            process.send_signal(signal.SIGKILL)
            lines += process.stdout.readlines()
        saved = int([line for line in lines if line.endswith("\n")][-1])
        arrays, scalars = checkpoint.load(tmp_path, "d")
        assert scalars["step"] >= saved
        assert (arrays["x"] == scalars["step"]).all()
    checkpoint.save(tmp_path, {}, {"step": 10**7}, "d")
    assert len(list(tmp_path.iterdir())) == 2
