"""Anchors as PLY files of the reference code: the layout, the way and back, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgs.data.ply import Table, pack_ply, read_ply
from clgs.data.scaffold_ply import NAMES, load_scaffold, mlps_path, save_scaffold
from clgs.errors import DataError
from clgs.scene.anchors import QuantizationScales
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform
from tests.codec.scenes import assert_same, random_scene


@pytest.fixture
def scene(rng: np.random.Generator) -> QuantizedScene:
    scales = QuantizationScales(1 / 0.003, 1.5, 0.7, 8.0)
    transform = SceneTransform((0.1, -2.0, 1 / 3), 0.7)
    settings = RenderSettings(background=(0.25, 1.0, 0.0))
    return replace(random_scene(rng), scales=scales, transform=transform, settings=settings)


@pytest.mark.parametrize("name", ["scene.ply", "scene.quantized.ply"])
def test_the_way_and_back_is_exact(scene: QuantizedScene, tmp_path: Path, name: str) -> None:
    save_scaffold(tmp_path / name, scene)
    assert mlps_path(tmp_path / name) == tmp_path / "scene.mlps.npz"
    assert_same(load_scaffold(tmp_path / name), scene)


def test_layout_is_that_of_the_reference(scene: QuantizedScene, tmp_path: Path) -> None:
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


def test_files_of_others_need_no_comments(scene: QuantizedScene, tmp_path: Path) -> None:
    path = tmp_path / "s.ply"
    save_scaffold(path, scene)
    path.write_bytes(pack_ply(Table(read_ply(path).columns)))
    found = load_scaffold(path, scales=scene.scales)
    assert_same(found, replace(scene, transform=SceneTransform(), settings=RenderSettings()))
    np.savez(tmp_path / "flat.npz", mlps=scene.mlps.flat)
    flat = load_scaffold(path, tmp_path / "flat.npz").mlps.flat
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
        ("scale_0", 0.5, "not all numbers are whole"),
    ],
)
def test_damaged_anchors_are_refused(
    scene: QuantizedScene, tmp_path: Path, name: str, value: float | None, message: str
) -> None:
    path = tmp_path / "s.quantized.ply"
    save_scaffold(path, scene)
    change(path, name, value)
    with pytest.raises(DataError, match=message):
        load_scaffold(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"scales.offset 1.5", b"scales.offset 0.0"),
        (b"scales.offset 1.5", b"scales.offset nan"),
        (b"scales.offset 1.5", b"scales.offset a b"),
        (b"scales.offset 1.5", b"scales.offsat 1.5"),
        (b"transform.scale 0.7", b"transform.scale 1 2"),
    ],
)
def test_damaged_comments_are_refused(
    scene: QuantizedScene, tmp_path: Path, old: bytes, new: bytes
) -> None:
    path = tmp_path / "s.ply"
    save_scaffold(path, scene)
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(DataError, match=r"s\.ply: "):
        load_scaffold(path)


def test_mlps_are_needed_and_checked(scene: QuantizedScene, tmp_path: Path) -> None:
    path = tmp_path / "s.ply"
    save_scaffold(path, scene)
    mlps_path(path).unlink()
    with pytest.raises(DataError, match="--mlps"):
        load_scaffold(path)
    np.savez(mlps_path(path), **{"opacity_mlp.0.weight": np.zeros((50, 54))})  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"shape \(50, 54\)"):
        load_scaffold(path)
    np.savez(mlps_path(path), mlps=np.full(13710, np.nan, np.float32))
    with pytest.raises(DataError, match="not finite"):
        load_scaffold(path)
    mlps_path(path).write_bytes(b"\x80\x04K\x01.")  # a pickle
    with pytest.raises(DataError, match="not an archive"):
        load_scaffold(path)
