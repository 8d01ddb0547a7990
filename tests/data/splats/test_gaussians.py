"""Ordinary Gaussians from 3DGS PLY files and from what `clgs pack` made of them."""

import numpy as np
import pytest

from clgs.codec.splat_packing import pack, unpack
from clgs.data.splats.gaussians import load_splats, scene_of_packed
from clgs.data.splats.integer_splats import read_splats, write_splats
from clgs.data.splats.ply import PlyTable, pack_ply, read_ply
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
    columns |= {f"rot_{i}": gaussians.rotation[:, i] for i in range(4)}
    return {name: column.copy() for name, column in columns.items()}


def write(path, columns, comments=()):
    path.write_bytes(pack_ply(PlyTable(columns, list(comments))))
    return path


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_file_is_read_as_it_was_meant(tmp_path, rng, degree):
    gaussians = stored(rng, 30, degree)
    found = load_splats(write(tmp_path / "s.ply", columns_of(gaussians))).gaussians
    assert found.degree == degree
    for name, array in found.items():
        assert np.array_equal(array, getattr(gaussians, name)), name


def test_packed_splats_are_the_same_but_for_their_steps(tmp_path, rng):
    path = write(tmp_path / "s.ply", columns_of(stored(rng, 200)))
    splats, errors = read_splats(path, {})
    found = scene_of_packed(unpack(pack(splats)), path).gaussians
    before = load_splats(path).gaussians
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
    for name in ("x", "f_dc_1", "opacity", "scale_1", "rot_3", "f_rest_7"):
        rest = {key: value for key, value in columns.items() if key != name}
        with pytest.raises(DataError, match=r"is missing|make a whole degree"):
            load_splats(write(tmp_path / "s.ply", rest))
    fewer = {key: value for key, value in columns.items() if key not in ("f_rest_44", "f_rest_43")}
    with pytest.raises(DataError, match=r"s\.ply: 43 properties f_rest_\*"):
        load_splats(write(tmp_path / "s.ply", fewer))
    with pytest.raises(DataError, match="holds anchors"):
        load_splats(write(tmp_path / "s.ply", {**columns, "f_anchor_feat_0": columns["x"]}))
    with pytest.raises(DataError, match="no such file"):
        load_splats(tmp_path / "none.ply")


@pytest.mark.parametrize("count", [0, 3])
def test_a_file_without_splats_to_draw_is_one_line(tmp_path, rng, count):
    columns = {key: value[:count].copy() for key, value in columns_of(stored(rng, 3)).items()}
    columns["opacity"][:] = np.nan
    with pytest.raises(DataError, match=r"^[^\n]*s\.ply: holds no splats that can be drawn"):
        load_splats(write(tmp_path / "s.ply", columns))


def test_broken_splats_are_left_out_and_counted(tmp_path, rng, caplog):
    columns = columns_of(stored(rng, 10))
    columns["opacity"][4], columns["f_rest_9"][7] = np.nan, np.inf
    found = load_splats(write(tmp_path / "s.ply", columns)).gaussians
    assert len(found) == 8
    assert "2 of 10 splats" in caplog.text


def test_rotations_that_are_none_are_left_out_and_counted(tmp_path, rng, caplog):
    """Formats whose rotations have length 1 would let them be seen."""
    columns = columns_of(stored(rng, 10))
    for i in range(4):
        columns[f"rot_{i}"] = np.where(np.arange(10) < 3, np.float32(0), columns[f"rot_{i}"])
    assert len(load_splats(write(tmp_path / "s.ply", columns)).gaussians) == 7
    assert "s.ply: 3 of 10 splats have a rotation of length 0" in caplog.text


@pytest.mark.parametrize("length", [1e-44, 1e-36, 3e37, 3e38])
def test_quaternions_of_any_length_are_the_same_rotations(tmp_path, rng, length):
    columns = columns_of(stored(rng, 10))
    usual = load_splats(write(tmp_path / "a.ply", columns)).gaussians
    axis = np.eye(4)[rng.integers(4, size=10)]
    for i in range(4):
        columns[f"rot_{i}"] = (length * axis[:, i]).astype(np.float32)
    found = load_splats(write(tmp_path / "b.ply", columns)).gaussians
    assert len(found) == len(usual)
    np.testing.assert_array_equal(found.rotation, axis)


def test_infinite_opacities_and_scales_have_a_meaning(tmp_path, rng, caplog):
    """An opacity of 1 has the logit +inf; a flat splat has the log scale -inf."""
    columns = columns_of(stored(rng, 10))
    columns["opacity"][2], columns["scale_1"][3] = np.inf, -np.inf
    path = write(tmp_path / "s.ply", columns)
    found = load_splats(path).gaussians
    assert len(found) == 10
    assert caplog.text == ""
    assert 1 / (1 + np.exp(-found.opacity[2])) == 1
    assert np.exp(found.log_scale[3, 1]) < 1e-8
    assert read_splats(path, {})[1]["opacity"] <= 1 / 64
    columns["opacity"][4], columns["scale_1"][5] = -np.inf, np.inf
    assert len(load_splats(write(path, columns)).gaussians) == 8
    assert "2 of 10 splats have numbers that are not finite" in caplog.text


def test_flat_splats_have_no_third_scale(tmp_path, rng):
    columns = columns_of(stored(rng, 10))
    del columns["scale_2"]
    found = load_splats(write(tmp_path / "s.ply", columns)).gaussians
    assert (found.log_scale[:, 2] == -20).all()


@pytest.mark.parametrize(("kind", "white"), [("u1", 255), ("u2", 65535), ("f4", 1), ("f4", 255)])
def test_colors_of_splats_may_be_those_of_a_display(tmp_path, rng, kind, white):
    columns = columns_of(stored(rng, 10, 0))
    for i, name in enumerate(("red", "green", "blue")):
        columns[name] = np.rint(np.linspace(0, white, 10)).astype(kind)
        del columns[f"f_dc_{i}"]
    found = load_splats(write(tmp_path / "s.ply", columns)).gaussians
    shown = 0.5 + 0.28209479177387814 * found.sh[:, 0]
    assert np.allclose(shown, columns["red"][:, None] / white, atol=1e-6)


def test_coefficients_of_degree_4_are_cut(tmp_path, rng, caplog):
    gaussians = stored(rng, 10)
    columns = columns_of(gaussians)
    for channel in reversed(range(3)):
        for i in range(24):
            value = gaussians.sh[:, 1 + i, channel] if i < 15 else np.ones(10, np.float32)
            columns[f"f_rest_{24 * channel + i}"] = value
    found = load_splats(write(tmp_path / "s.ply", columns)).gaussians
    assert np.array_equal(found.sh, gaussians.sh)
    assert "s.ply: colors of degree 4 are cut to 3" in caplog.text


@pytest.mark.parametrize("thickness", ["a ball", None, -np.inf, -30.0])
def test_a_filter_widens_splats_and_keeps_their_light(tmp_path, rng, thickness):
    """A variance of v under a filter of 3 v: twice as wide on each axis, half as opaque for it."""
    gaussians = stored(rng, 10)
    gaussians.log_scale[:] = gaussians.log_scale[:, :1]
    columns, axes = columns_of(gaussians), 3 if thickness == "a ball" else 2
    columns["filter_3D"] = np.exp(gaussians.log_scale[:, 0]) * np.float32(3**0.5)
    if thickness is None:
        del columns["scale_2"]
    elif axes == 2:
        columns["scale_2"] = np.full(10, thickness, np.float32)
    path = write(tmp_path / "s.ply", columns)
    found = load_splats(path).gaussians
    assert found.antialiased
    wider = gaussians.log_scale[:, :axes] + np.log(2)
    assert np.allclose(found.log_scale[:, :axes], wider, atol=1e-5)
    before, after = (1 / (1 + np.exp(-one.opacity)) for one in (gaussians, found))
    assert np.allclose(after, before / 2**axes, rtol=1e-4)
    assert "filter_3D" not in read_splats(path, {})[0].names


@pytest.mark.parametrize(
    ("comments", "antialiased"),
    [
        ([], False),
        (["made by hand", "antialiasing is good"], False),
        (["SplatRenderMode: mip"], True),
        (["splatrendermode: antialiased"], True),
        (["SplatRenderMode: default"], False),
        (["SplatRenderMode: mip", "SplatRenderMode: 2dgs"], False),
        (["rasterize_mode = antialiased"], True),
        (["antialiased 1"], True),
        (["antialiased 0"], False),
        (["Antialiased: true"], True),
        (["antialiased"], True),
        (["postshot.anti_aliasing=1"], True),
        (["postshot.anti_aliasing=0"], False),
        (["antialiased=1; version=2"], True),
        (["version=2, antialiased=0"], False),
        (['{"renderer": "x", "antialiased": true}'], True),
        (["render-mode: mip"], True),
        (["anti-aliased 1"], True),
        (["mip-splatting"], True),
        (["Mip-Splatting: false"], False),
        (["trained without mip-splatting"], False),
        (["Rasterize mode: antialiased"], True),
        (["rasterization_mode = classic"], False),
        (["pipeline.model.rasterize-mode antialiased"], True),
        (["splat render mode: mip"], True),
        (["anti aliased 1.0"], True),
        (["--antialiasing"], True),
        (["antialiased=1 sh=3"], True),
        (["sh=3 antialiased: false steps=7"], False),
        (["app.version 2 app.antialias=on"], True),
        (["train.py -m out --antialiasing --iterations 7000"], True),
        (["train.py --no-antialiasing"], False),
        (["Trained for 30 minutes. Antialiasing was enabled."], True),
        (["rasterize_mode=antialiased sh_degree=3"], True),
        (["antialiased 1", "rasterize_mode=classic sh_degree=3"], False),
        (["antialiased 1", "SplatRenderModes and others"], True),
    ],
)
def test_marks_of_antialiased_splats(tmp_path, rng, comments, antialiased):
    path = write(tmp_path / "s.ply", columns_of(stored(rng, 5)), comments)
    assert load_splats(path).gaussians.antialiased == antialiased
    path.write_bytes(path.read_bytes().replace(b"\ncomment ", b"\nobj_info "))
    assert load_splats(path).gaussians.antialiased == antialiased
    packed = tmp_path / "s.clgs"
    packed.write_bytes(pack(read_splats(path, {})[0]))
    assert load_splats(packed).gaussians.antialiased == antialiased
    path.write_bytes(write_splats(unpack(packed.read_bytes())))
    assert load_splats(path).gaussians.antialiased == antialiased
    assert "antialiased" not in read_ply(path).columns


@pytest.mark.parametrize(
    "comment",
    [
        *("antialiasing is good", "trained without mip-splatting", "no-antialiasing=1"),
        *("antialiased 0.3", "SplatRenderMode: surfels"),
    ],
)
def test_a_comment_that_may_mean_either_is_told(tmp_path, rng, caplog, comment):
    columns = columns_of(stored(rng, 5))
    path = write(tmp_path / "s.ply", columns, [comment])
    assert not load_splats(path).gaussians.antialiased
    assert f"s.ply: comment {comment!r}: unclear whether splats are antialiased" in caplog.text
    caplog.clear()
    write(path, columns, [comment, "antialiased=1 sh=3"])
    assert load_splats(path).gaussians.antialiased
    assert not caplog.text


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_far_scenes_are_moved_to_the_origin(tmp_path, rng, kind):
    gaussians, place = stored(rng, 100), np.array([5e5, 5.4e6, 120.0])
    columns = columns_of(gaussians)
    for i, name in enumerate("xyz"):
        columns[name] = (gaussians.mean[:, i].astype(np.float64) + place[i]).astype(kind)
    scene = load_splats(write(tmp_path / "s.ply", columns))
    centre = np.array(scene.transform.centre)
    assert scene.transform.scale == 1
    assert np.abs(centre - place).max() < 2
    wanted = np.stack([columns[name] for name in "xyz"], 1).astype(np.float64) - centre
    assert np.abs(scene.gaussians.mean - wanted).max() < 1e-6
    packed = scene_of_packed(read_splats(tmp_path / "s.ply", {})[0], tmp_path)
    assert np.abs(np.array(packed.transform.centre) - centre).max() < 0.5


def test_coordinates_in_text_keep_their_digits(tmp_path, rng):
    """A header that names a type of fewer digits does not cut them."""
    gaussians, place = stored(rng, 100), np.array([5e5, 5.4e6, 120.0])
    columns = columns_of(gaussians)
    text = [*pack_ply(PlyTable(columns)).partition(b"end_header\n")[:2]]
    text[0] = text[0].replace(b"binary_little_endian", b"ascii")
    for i, name in enumerate("xyz"):
        columns[name] = gaussians.mean[:, i].astype(np.float64) + place[i]
    for row in zip(*columns.values(), strict=True):
        text.append(" ".join(repr(value.item()) for value in row).encode() + b"\n")
    (tmp_path / "s.ply").write_bytes(b"".join(text))
    scene = load_splats(tmp_path / "s.ply")
    wanted = np.stack([columns[name] for name in "xyz"], 1) - scene.transform.centre
    assert np.abs(scene.gaussians.mean - wanted).max() < 1e-6


@pytest.mark.parametrize(
    ("times", "near"), [(1.0, 0.2), (0.01, 0.0047), (1e-4, 0.000047), (1e3, 0.2 * 4700 / 40)]
)
def test_the_near_plane_follows_the_size_of_scenes(tmp_path, rng, times, near):
    columns = columns_of(stored(rng, 100))
    for name in "xyz":
        columns[name] = columns[name] * np.float32(4 * times)
    for i in range(3):
        columns[f"scale_{i}"] = columns[f"scale_{i}"] + np.float32(np.log(4 * times))
    found = load_splats(write(tmp_path / "s.ply", columns)).settings.near
    # half of the points in a cube of 9.6 units lie within 4.7 units of its middle
    assert found == pytest.approx(near, rel=0.1)
