"""A stored scene comes back exactly; anything wrong with the file is one clear error."""

from __future__ import annotations

import gc
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest

from clgs.data.splats.anchors import load_mlps
from clgs.data.splats.gaussians import load_splats
from clgs.errors import DataError, UsageError
from clgs.lab.bench.codec import file_subjects
from clgs.scene.storage import ARRAY_NAMES, LATER, load_scene, save_scene
from clgs.train.quality.lpips import expected_arrays, read_lpips_weights
from clgs.train.state import checkpoint
from tests.codec.scenes import assert_same, random_scene


@pytest.fixture
def scene():
    return random_scene(np.random.default_rng(1), 5)


@pytest.fixture
def arrays(scene, tmp_path):
    save_scene(tmp_path / "scene.npz", scene)
    with np.load(tmp_path / "scene.npz") as archive:
        return dict(archive)


def load_subjects(path):
    return file_subjects([path])


def load_checkpoint(path):
    return checkpoint.load(path.parent, "")


def refusal(path):
    with pytest.raises(DataError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


def test_a_scene_comes_back_exactly(scene, tmp_path):
    save_scene(tmp_path / "scene.npz", scene)
    assert_same(load_scene(tmp_path / "scene.npz"), scene)
    save_scene(str(tmp_path / "other.npz"), scene)
    assert_same(load_scene(str(tmp_path / "other.npz")), scene)


def test_a_missing_file_and_another_kind_are_named(scene, tmp_path):
    assert "no such file; name the scene.npz of a run" in refusal(str(tmp_path / "none.npz"))
    assert "is a folder; name the scene.npz of a run" in refusal(str(tmp_path))
    (tmp_path / "x.clgs").write_bytes(b"CLGS")
    assert refusal(str(tmp_path / "x.clgs")).endswith("; clgs.decode reads it")
    (tmp_path / "x.clgs").unlink()
    with pytest.raises(UsageError, match=r"foo\.txt: .* name it \.npz"):
        save_scene(str(tmp_path / "foo.txt"), scene)
    with pytest.raises(TypeError, match="scene: is NoneType, QuantizedScene is needed"):
        save_scene(tmp_path / "x.npz", None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [name for name in ARRAY_NAMES if name not in LATER])
def test_no_array_may_be_missing(arrays, tmp_path, name):
    del arrays[name]
    np.savez(tmp_path / "x.npz", **arrays)
    assert f"array {name} is missing" in refusal(tmp_path / "x.npz")


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("scales.position", np.float64(-1), "Q of position is -1.0"),
        ("scales.feature", np.float64(0), "Q of feature is 0.0"),
        ("scales.offset", np.float64(np.nan), "Q of offset is nan"),
        ("transform.centre", np.array([0, np.inf, 0]), "transform centre is inf"),
        ("transform.centre", np.zeros(2), "transform.centre: shape"),
        ("transform.scale", np.float64(1e300), "transform scale is 1e+300"),
        ("settings.background", np.float64(0), "settings.background: shape"),
        ("settings.near", np.zeros((2, 2)), "settings.near: shape"),
        ("settings.near", np.array("near"), "settings.near: dtype"),
        ("settings.blur", np.float64(-1), "blur is -1.0"),
        ("mlps", np.full(13710, np.nan, np.float32), "mlps: a weight is not finite"),
        ("mlps", np.zeros(13710), "mlps: dtype"),
        ("position", np.zeros((5, 3)), "position: dtype"),
        ("offset", np.zeros((1, 10, 3), np.int32), "offset: shape"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(arrays, tmp_path, name, value, said):
    np.savez(tmp_path / "x.npz", **arrays | {name: value})
    text = refusal(tmp_path / "x.npz")
    assert said in text
    assert text.endswith("; write the file again")


def test_no_damage_escapes(arrays, tmp_path):
    rng = np.random.default_rng(2)
    small = {name: array for name, array in arrays.items() if name != "mlps"}
    np.savez(tmp_path / "x.npz", **small)
    whole = (tmp_path / "x.npz").read_bytes()
    for _ in range(120):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        (tmp_path / "x.npz").write_bytes(data)
        refusal(tmp_path / "x.npz")
    for size in (0, 3, len(whole) // 2, len(whole) - 1):
        (tmp_path / "x.npz").write_bytes(whole[:size])
        refusal(tmp_path / "x.npz")
    np.save(tmp_path / "y.npy", np.zeros(3))
    refusal(tmp_path / "y.npy")
    refusal(tmp_path)


@pytest.mark.slow
def test_a_damaged_archive_is_closed(arrays, tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, mlps=arrays["mlps"])
    path.write_bytes(path.read_bytes()[:1000])
    gc.collect()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        refusal(path)
        gc.collect()
    assert not [one for one in said if one.category is ResourceWarning]


def bomb(path, names):
    """An archive of zeros that takes a thousandth of what it declares, 64 MiB an array."""
    np.savez_compressed(path, **dict.fromkeys(names, np.zeros(1 << 26, np.uint8)))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("read", [load_scene, load_mlps, load_subjects, load_checkpoint])
def test_declared_sizes_are_bounded_before_anything_is_read(tmp_path, read):
    """Archives that users name, those next to them, and checkpoints are looked at first."""
    path = bomb(tmp_path / "step_00000010.npz", ["feature", "mlps", "values"])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("metadata.json", '{"version": 1, "arrays": {"mlps": 0}, "digest": ""}')
    tracemalloc.start()
    with warnings.catch_warnings(action="ignore"), pytest.raises(DataError):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 23


@pytest.mark.parametrize("way", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize(
    ("read", "name"),
    [
        (load_scene, "mlps.npy"),
        (load_mlps, "mlps.npy"),
        (load_checkpoint, "metadata.json"),
        (read_lpips_weights, f"{next(expected_arrays())[0]}.npy"),
        (load_splats, "meta.json"),
    ],
)
def test_sizes_that_are_declared_too_small_take_no_memory(tmp_path, read, name, way):
    path = tmp_path / ("s.sog" if read is load_splats else "step_00000010.npz")
    with zipfile.ZipFile(path, "w", way) as archive:
        archive.writestr(name, bytes(1 << 24))
    end = path.read_bytes().rpartition(b"PK\x01\x02")
    directory = end[2][:20] + (1000).to_bytes(4, "little") + end[2][24:]
    path.write_bytes(end[0] + end[1] + directory)
    tracemalloc.start()
    with warnings.catch_warnings(action="ignore"), pytest.raises(DataError):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 23


def test_what_a_declared_size_is_refused_for_is_said(tmp_path):
    text = refusal(bomb(tmp_path / "x.npz", ["feature"]))
    assert "bytes that declare arrays of 67,108,992 bytes" in text


def test_no_room_is_no_damage(scene, tmp_path, monkeypatch):
    """But an array that is larger than any in so small a file may be is."""
    path = tmp_path / "scene.npz"
    save_scene(path, scene)
    data = path.read_bytes()
    shape = b"(5, 10, 3), }                     "
    assert shape in data
    path.write_bytes(data.replace(shape, b"(5, 1000000000000000, 3), }".ljust(len(shape))))
    assert "not a scene archive" in refusal(path)
    save_scene(path, scene)

    def fail(*_):
        raise MemoryError

    monkeypatch.setattr("clgs.scene.storage._scene", fail)
    with pytest.raises(MemoryError):
        load_scene(path)
