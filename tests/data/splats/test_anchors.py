"""Anchors as PLY files of the reference code: the layout, the way and back, what is refused."""

import os
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.data.splats.anchors import NAMES, load_scaffold, mlps_path, pack_mlps, save_scaffold
from clgs.data.splats.ply import PlyTable, pack_ply, read_ply
from clgs.errors import DataError, OutputError, UsageError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform
from tests.codec.scenes import assert_same, random_scene


@pytest.fixture
def scene(rng):
    scales = QuantizationScales(1 / 0.003, 1.5, 0.7, 8.0)
    transform = SceneTransform((0.1, -2.0, 1 / 3), 0.7)
    settings = RenderSettings(background=(0.25, 1.0, 0.0))
    return replace(random_scene(rng), scales=scales, transform=transform, settings=settings)


@pytest.fixture
def saved(scene, tmp_path):
    """The file of the scene as floats."""
    save_scaffold(tmp_path / "s.ply", scene)
    return tmp_path / "s.ply"


@pytest.mark.parametrize("name", ["scene.ply", "scene.quantized.ply"])
def test_the_way_and_back_is_exact(scene, tmp_path, name):
    save_scaffold(tmp_path / name, scene)
    assert mlps_path(tmp_path / name) == tmp_path / "scene.mlps.npz"
    assert_same(load_scaffold(tmp_path / name), scene)


_PLACE = st.integers(-(2**31), 2**31 - 1) | st.integers(2**23 - 9, 2**25)
_Q = st.floats(2.0**-64, 2.0**64) | st.floats(0.01, 1000) | st.sampled_from([200.0, 1 / 3, 8.0])


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.lists(_PLACE, min_size=1, max_size=12), st.tuples(_Q, _Q, _Q, _Q), st.booleans())
def test_every_integer_of_every_q_comes_back(places, q, quantized):
    def filled(*shape: int) -> npt.NDArray[np.int32]:
        return np.resize(np.array(places, np.int32), (3, *shape))

    anchors = QuantizedAnchors(filled(3), filled(10, 3), filled(50), filled(6))
    before = QuantizedScene(anchors, Mlps(np.zeros(MLP_SIZE, np.float32)), QuantizationScales(*q))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("s.quantized.ply" if quantized else "s.ply")
        save_scaffold(path, before)
        assert_same(load_scaffold(path), before)
        kinds = {column.dtype.str for column in read_ply(path).columns.values()}
    small = max(abs(place) for place in places) <= 2**22
    assert kinds == {"<f4"} if small else kinds <= {"<f4", "<f8"}


def test_far_positions_are_doubles_and_the_rest_floats(scene, tmp_path):
    """16.5 million at Q 200 is 82,500.00x: float32 has steps of 1/128 there, coarser than 1/200."""
    scene = replace(scene, scales=QuantizationScales())
    scene.anchors.position[:, 0] += 16_500_001
    save_scaffold(tmp_path / "s.ply", scene)
    kinds = {name: column.dtype for name, column in read_ply(tmp_path / "s.ply").columns.items()}
    assert {name for name, kind in kinds.items() if kind == np.float64} == {"x"}
    assert_same(load_scaffold(tmp_path / "s.ply"), scene)


def test_layout_is_that_of_the_reference(scene, tmp_path):
    save_scaffold(tmp_path / "s.quantized.ply", scene)
    save_scaffold(tmp_path / "s.ply", scene)
    integers, floats = (
        read_ply(tmp_path / f"s{end}").columns for end in (".quantized.ply", ".ply")
    )
    assert list(integers) == NAMES
    assert len(NAMES) == 3 + 3 + 30 + 50 + 1 + 6 + 4
    assert all(column.dtype == np.float32 for column in floats.values())
    np.testing.assert_array_equal(integers["f_offset_13"], scene.anchors.offset[:, 3, 1])
    np.testing.assert_array_equal(integers["f_anchor_feat_49"], scene.anchors.feature[:, 49])
    expected = (scene.anchors.scaling[:, 5] / 8.0).astype(np.float32)
    np.testing.assert_array_equal(floats["scale_5"], expected)


def test_files_of_others_need_no_comments(scene, saved, tmp_path):
    saved.write_bytes(pack_ply(PlyTable(read_ply(saved).columns)))
    found = load_scaffold(saved, scales=scene.scales)
    assert_same(found, replace(scene, transform=SceneTransform(), settings=RenderSettings()))
    np.savez(tmp_path / "flat.npz", mlps=scene.mlps.flat)
    flat = load_scaffold(saved, tmp_path / "flat.npz").mlps.flat
    np.testing.assert_array_equal(flat, scene.mlps.flat)


def change(path: Path, name: str, value: float | None) -> None:
    """Set the first number of a property, or leave the property out."""
    table = read_ply(path)
    if value is None:
        del table.columns[name]
    else:
        table.columns[name][0] = value
    path.write_bytes(pack_ply(table))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("f_offset_29", None, "f_offset_29 is missing"),
        ("f_anchor_feat_3", np.nan, "f_anchor_feat_3 of row 0 is nan"),
        ("x", np.inf, "x of row 0 is inf"),
        ("scale_0", 3e9, "scale_0 of row 0"),
        ("scale_0", 3e9, r"beyond int32; correct it or leave the anchor out$"),
        ("scale_0", 0.5, r"not all numbers are whole; give it another name, or round them$"),
    ],
)
def test_damaged_anchors_are_refused(scene, tmp_path, name, value, message):
    path = tmp_path / "s.quantized.ply"
    save_scaffold(path, scene)
    change(path, name, value)
    with pytest.raises(DataError, match=message):
        load_scaffold(path)


@pytest.mark.parametrize(
    ("name", "letter"),
    [("x", "P"), ("f_offset_29", "O"), ("f_anchor_feat_3", "A"), ("scale_5", "S")],
)
@pytest.mark.parametrize("value", [-4.5e9, 1e25])
def test_the_q_that_is_named_in_a_refusal_works(scene, saved, name, letter, value):
    field = dict(P="position", O="offset", A="feature", S="scaling")
    change(saved, name, value)
    with pytest.raises(DataError, match=rf"{name} of row 0 is \S+, beyond int32 at Q") as caught:
        load_scaffold(saved, scales=QuantizationScales(1e3, 1e3, 1e3, 1e3))
    said = re.search(rf"or give {letter} of --q P,O,A,S as (\S+) or less$", str(caught.value))
    found = load_scaffold(saved, scales=replace(scene.scales, **{field[letter]: float(said[1])}))
    assert np.ptp(found.anchors.position, axis=0).max() < 2**21


def test_a_number_that_no_q_holds(saved):
    change(saved, "x", 3e38)
    said = r"x of row 0 is 3e\+38, beyond int32 at Q .* leave the anch"
    with pytest.raises(DataError, match=said):
        load_scaffold(saved)


def test_ordinary_splats_are_for_another_command(tmp_path):
    column = np.zeros(2, np.float32)
    (tmp_path / "s.ply").write_bytes(pack_ply(PlyTable({"x": column, "y": column, "z": column})))
    said = "f_offset_0 is missing; this is no file of anchors .`clgs pa"
    with pytest.raises(DataError, match=said):
        load_scaffold(tmp_path / "s.ply")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"scales.offset 1.5", b"scales.offset 0.0"),
        (b"scales.offset 1.5", b"scales.offset nan"),
        (b"scales.offset 1.5", b"scales.offset a b"),
        (b"scales.offset 1.5", b"scales.offsat 1.5"),
        (b"scales.offset 1.5", b"scales.offset"),
        (b"transform.scale 0.7", b"transform.scale 1 2"),
    ],
)
def test_damaged_comments_are_refused(saved, old, new):
    assert old in saved.read_bytes()
    saved.write_bytes(saved.read_bytes().replace(old, new))
    with pytest.raises(DataError, match=r"s\.ply: "):
        load_scaffold(saved)


def test_comments_of_other_programs_are_passed_over(scene, saved):
    lines = ["clgs", "clgs is great", "clgs 1 2", "clgs scalesx 1", "clgs my.scale 7", "scale 7"]
    table = read_ply(saved)
    saved.write_bytes(pack_ply(PlyTable(table.columns, [*lines, *table.comments, *lines])))
    assert_same(load_scaffold(saved), scene)


def test_q_of_integers_is_what_the_file_says(scene, tmp_path):
    """Another Q would make another scene; floats may be rounded to it."""
    floats, integers = tmp_path / "s.ply", tmp_path / "s.quantized.ply"
    for path in (floats, integers):
        save_scaffold(path, scene)
        assert_same(load_scaffold(path, scales=scene.scales), scene)
    other = QuantizationScales(100.0, 1.5, 0.7, 8.0)
    assert load_scaffold(floats, scales=other).scales == other
    said = r"s\.quantized\.ply: its integers have Q 333.333,1.5,0.7,8"
    with pytest.raises(UsageError, match=said):
        load_scaffold(integers, scales=other)
    integers.write_bytes(pack_ply(PlyTable(read_ply(integers).columns)))
    found = load_scaffold(integers, scales=other)
    np.testing.assert_array_equal(found.anchors.position, scene.anchors.position)
    assert found.scales == other


def test_both_files_are_written_or_none(scene, saved, tmp_path, monkeypatch):
    replaced = []
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert sorted(before) == ["s.mlps.npz", "s.ply"]
    other = replace(scene, mlps=Mlps(scene.mlps.flat + 1), scales=QuantizationScales())
    rename = os.replace

    def second_fails(source: Path, target: Path) -> None:
        replaced.append(target)
        if len(replaced) == 2:
            raise OSError(1, "Operation not permitted")
        rename(source, target)

    for files in (before, {}):
        replaced.clear()
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", second_fails)
            with pytest.raises(OSError, match="not permitted"):
                save_scaffold(saved, other)
        assert [target.name for target in replaced[:2]] == ["s.mlps.npz", "s.ply"]
        assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == files
        for file in tmp_path.iterdir():
            file.unlink()
    mlps_path(saved).mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        save_scaffold(saved, scene)
    assert list(tmp_path.iterdir()) == [mlps_path(saved)]


def test_other_mlps_are_not_overwritten_unasked(scene, tmp_path):
    path = tmp_path / "s.ply"
    for content in (b"my own", pack_mlps(Mlps(scene.mlps.flat * 2))):
        mlps_path(path).write_bytes(content)
        with pytest.raises(OutputError, match="holds other MLPs; remove it or choose another"):
            save_scaffold(path, scene)
        assert mlps_path(path).read_bytes() == content
        assert not path.exists()
    np.savez(mlps_path(path), mlps=scene.mlps.flat)
    content = mlps_path(path).read_bytes()
    for name in ("s.ply", "s.quantized.ply"):
        save_scaffold(tmp_path / name, scene)
        assert mlps_path(path).read_bytes() == content
    other = replace(scene, mlps=Mlps(scene.mlps.flat * 2))
    save_scaffold(path, other)  # both names are there: a second decoding replaces the first
    assert_same(load_scaffold(path), other)


@pytest.mark.parametrize("name", ["S.PLY", "S.Quantized.Ply", "S.quantized.PLY"])
def test_the_case_of_the_name_does_not_matter(scene, tmp_path, name):
    save_scaffold(tmp_path / name, scene)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(["S.mlps.npz", name])
    assert_same(load_scaffold(tmp_path / name), scene)
    whole = read_ply(tmp_path / name).columns["x"] == scene.anchors.position[:, 0]
    assert whole.all() == ("uant" in name)


def test_archives_that_are_none_are_told_without_options_of_numpy(scene, saved, tmp_path):
    arrays = {"mlps": np.array([{}, 1], object)}
    np.savez(tmp_path / "objects.npz", **arrays)  # type: ignore[arg-type]
    np.savez(tmp_path / "others.npz", weights=scene.mlps.flat)
    np.save(tmp_path / "one.npy", scene.mlps.flat)
    (tmp_path / "torch.pth").write_bytes(b"\x80\x04K\x01.")
    for name, problem in {
        "objects.npz": "no NumPy archive of plain numbers; pickles are never read",
        "torch.pth": "no NumPy archive of plain numbers; pickles are never read",
        "others.npz": "opacity_mlp.0.weight is not a file in the archive",
        "one.npy": "a single array",
    }.items():
        message = (
            f"{name}: not an archive of the MLPs ({problem}); save arrays opacity_mlp.0.weight"
        )
        with pytest.raises(DataError, match=re.escape(message)):
            load_scaffold(saved, tmp_path / name)


def test_mlps_are_needed_and_checked(saved):
    mlps_path(saved).unlink()
    with pytest.raises(DataError, match="--mlps"):
        load_scaffold(saved)
    np.savez(mlps_path(saved), **{"opacity_mlp.0.weight": np.zeros((50, 54))})  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"shape \(50, 54\)"):
        load_scaffold(saved)
    np.savez(mlps_path(saved), mlps=np.full(13710, np.nan, np.float32))
    with pytest.raises(DataError, match="not finite"):
        load_scaffold(saved)
    mlps_path(saved).write_bytes(b"\x80\x04K\x01.")  # a pickle
    with pytest.raises(DataError, match="not an archive"):
        load_scaffold(saved)
