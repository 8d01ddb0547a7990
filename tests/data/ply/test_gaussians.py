"""Ordinary Gaussians from 3DGS PLY files and from what `clgs pack` made of them."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.codec.splat_packing import pack, unpack
from clgs.data.ply.gaussians import gaussians_of_splats, load_splats, read_gaussians
from clgs.data.ply.integer_splats import read_splats
from clgs.data.ply.table import PlyTable, pack_ply
from clgs.errors import DataError
from tests.ops.cases.splats import stored


def columns_of(gaussians):
    """Columns as 3DGS orders them: all higher coefficients of a channel before the next's."""
    columns = {name: gaussians.mean[:, i] for i, name in enumerate("xyz")}
    columns |= {name: np.zeros(len(gaussians), np.float32) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{i}": gaussians.sh[:, 0, i] for i in range(3)}
    higher = gaussians.sh.shape[1] - 1
    for channel in range(3):
        for c in range(higher):
            columns[f"f_rest_{channel * higher + c}"] = gaussians.sh[:, 1 + c, channel]
    columns["opacity"] = gaussians.opacity
    columns |= {f"scale_{i}": gaussians.log_scale[:, i] for i in range(3)}
    return columns | {f"rot_{i}": gaussians.rotation[:, i] for i in range(4)}


def write(path, columns):
    path.write_bytes(pack_ply(PlyTable(columns)))
    return path


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_file_is_read_as_it_was_meant(tmp_path, rng, degree):
    gaussians = stored(rng, 30, degree)
    found = read_gaussians(write(tmp_path / "s.ply", columns_of(gaussians)))
    assert found.degree == degree
    for name, array in found.items():
        assert np.array_equal(array, getattr(gaussians, name)), name


def test_packed_splats_are_the_same_but_for_their_steps(tmp_path, rng):
    path = write(tmp_path / "s.ply", columns_of(stored(rng, 200)))
    splats, errors = read_splats(path, {})
    found = gaussians_of_splats(unpack(pack(splats)), path)
    before = read_gaussians(path)
    # Morton order: find each splat again by its place
    order = np.array([np.argmin(np.abs(found.mean - m).sum(axis=1)) for m in before.mean])
    assert sorted(order) == list(range(200))
    for name, most in (("mean", "position"), ("log_scale", "scale"), ("opacity", "opacity")):
        error = np.abs(getattr(found, name)[order] - getattr(before, name)).max()
        assert error <= errors[most] * 1.001 + 1e-6, name
    assert np.abs(found.sh[order] - before.sh).max() <= 1 / 64 + 1e-6


def test_both_kinds_of_file_are_loaded_by_name(tmp_path, rng):
    path = write(tmp_path / "s.ply", columns_of(stored(rng, 50)))
    (tmp_path / "s.clgs").write_bytes(pack(read_splats(path, {})[0]))
    assert len(load_splats(path).gaussians) == 50
    assert len(load_splats(str(tmp_path / "s.clgs")).gaussians) == 50
    with pytest.raises(DataError, match=r"none\.clgs: no such file"):
        load_splats(tmp_path / "none.clgs")
    (tmp_path / "bad.clgs").write_bytes(b"nothing")
    with pytest.raises(DataError, match=r"bad\.clgs: "):
        load_splats(tmp_path / "bad.clgs")


def test_what_is_no_splat_is_named(tmp_path, rng):
    columns = columns_of(stored(rng, 3))
    for name in ("x", "f_dc_1", "opacity", "scale_2", "rot_3", "f_rest_7"):
        rest = {key: value for key, value in columns.items() if key != name}
        with pytest.raises(DataError, match=r"is missing|make a whole degree"):
            read_gaussians(write(tmp_path / "s.ply", rest))
    fewer = {key: value for key, value in columns.items() if key not in ("f_rest_44", "f_rest_43")}
    with pytest.raises(DataError, match=r"s\.ply: 43 properties f_rest_\*"):
        read_gaussians(write(tmp_path / "s.ply", fewer))
    with pytest.raises(DataError, match="holds anchors"):
        read_gaussians(write(tmp_path / "s.ply", {**columns, "f_anchor_feat_0": columns["x"]}))
    with pytest.raises(DataError, match="no such file"):
        read_gaussians(tmp_path / "none.ply")


@pytest.mark.parametrize("count", [0, 3])
def test_a_file_without_splats_to_draw_is_one_line(tmp_path, rng, count):
    columns = {key: value[:count].copy() for key, value in columns_of(stored(rng, 3)).items()}
    columns["opacity"][:] = np.nan
    with pytest.raises(DataError, match=r"^[^\n]*s\.ply: holds no splats that can be drawn"):
        read_gaussians(write(tmp_path / "s.ply", columns))


def test_broken_splats_are_left_out_and_counted(tmp_path, rng, caplog):
    columns = columns_of(stored(rng, 10))
    columns["opacity"] = columns["opacity"].copy()
    columns["opacity"][4] = np.nan
    columns["f_rest_9"] = columns["f_rest_9"].copy()
    columns["f_rest_9"][7] = np.inf
    found = read_gaussians(write(tmp_path / "s.ply", columns))
    assert len(found) == 8
    assert "2 of 10 splats" in caplog.text


def test_rotations_that_are_none_are_counted(tmp_path, rng, caplog):
    columns = columns_of(stored(rng, 10))
    for i in range(4):
        columns[f"rot_{i}"] = np.where(np.arange(10) < 3, np.float32(0), columns[f"rot_{i}"])
    assert len(read_gaussians(write(tmp_path / "s.ply", columns))) == 10
    assert "s.ply: 3 of 10 splats have a rotation of length 0" in caplog.text
