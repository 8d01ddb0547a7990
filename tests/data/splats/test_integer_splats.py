"""Default steps of splats: fine enough for the splats, and held by the file wherever they lie."""

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgs.cli.main import main
from clgs.codec.splat_packing import QuantizedSplats, pack, sort_splats, unpack
from clgs.data.splats.gaussians import DC, POSITION, ROTATION, SCALE
from clgs.data.splats.integer_splats import (
    group_of,
    read_splats,
    resolution,
    usual_extent,
    write_splats,
)
from clgs.data.splats.ply import PlyTable, pack_ply, parse_ply, read_ply
from clgs.errors import UsageError

UTM = (4.5e6, 4e5, 100.0)
"""A place in metres on the map of a country."""


def cloud(
    rng: np.random.Generator, origin: tuple[float, ...] = (0, 0, 0), scale: float | None = 0.02
) -> dict[str, np.ndarray]:
    """1,000 splats in a cube of 8 units: float64, by property."""
    columns = {name: origin[i] + rng.uniform(0, 8, 1000) for i, name in enumerate("xyz")}
    columns["opacity"] = rng.normal(size=1000)
    if scale:
        columns |= {f"scale_{i}": np.full(1000, np.log(scale)) for i in range(3)}
    return columns


def steps_of(
    folder: Path, columns: dict[str, np.ndarray], kind: str = "f4", **named: float
) -> list[float]:
    """The steps of x, y and z; the way to the file and back must keep every integer."""
    path = folder / "s.ply"
    path.write_bytes(pack_ply(PlyTable({name: c.astype(kind) for name, c in columns.items()})))
    splats, errors = read_splats(path, named)
    found = unpack(pack(splats))
    np.testing.assert_array_equal(found.values, sort_splats(splats.values))
    assert errors["position"] <= max(splats.steps[:3]) / 2
    path.write_bytes(write_splats(found))
    again, _ = read_splats(path, dict(zip(splats.names, splats.steps, strict=True)))
    np.testing.assert_array_equal(again.values, found.values)
    return splats.steps[:3]


@pytest.fixture
def warned(caplog):
    caplog.set_level(logging.WARNING)
    return caplog


def test_ordinary_splats_have_an_eighth_of_their_median_scale(rng, tmp_path, warned):
    assert steps_of(tmp_path, cloud(rng)) == [2.0**-9] * 3
    assert steps_of(tmp_path, cloud(rng, scale=0.1)) == [2.0**-7] * 3
    assert steps_of(tmp_path, cloud(rng, scale=None)) == [2.0**-14] * 3  # 8 / 65536 = 2^-13
    assert steps_of(tmp_path, cloud(rng), x=0.5) == [0.5, 2.0**-9, 2.0**-9]
    one = {name: column[:1] for name, column in cloud(rng, scale=None).items()}
    assert steps_of(tmp_path, one) == [2.0**-16] * 3
    none = {name: column[:0] for name, column in cloud(rng).items()}
    assert steps_of(tmp_path, none) == [2.0**-16] * 3
    assert not warned.messages


def test_far_from_zero_float32_says_what_is_fine_enough(rng, tmp_path, warned):
    """Float32 has steps of 0.5 at 4.5e6 and of 1 / 32 at 4e5: coarse steps add no error."""
    columns = {name: column.astype("f4") for name, column in cloud(rng, UTM).items()}
    assert steps_of(tmp_path, columns) == [0.5, 2.0**-5, 2.0**-9]
    splats = unpack(pack(read_splats(tmp_path / "s.ply", {})[0]))
    for i, name in enumerate("xy"):
        np.testing.assert_array_equal(
            np.sort(splats.values[:, i] * splats.steps[i]), np.sort(columns[name])
        )
    assert steps_of(tmp_path, {n: c[:1] for n, c in columns.items()})[0] == 0.5
    assert not warned.messages


def test_doubles_far_from_zero_keep_their_steps_and_come_back_as_doubles(rng, tmp_path, warned):
    assert steps_of(tmp_path, cloud(rng, UTM, scale=0.1), "f8") == [2.0**-7] * 3
    assert not warned.messages
    kinds = {name: c.dtype.str for name, c in read_ply(tmp_path / "s.ply").columns.items()}
    assert kinds["x"] == "<f8"
    assert {kinds[name] for name in ("z", "opacity", "scale_0")} == {"<f4"}
    assert steps_of(tmp_path, cloud(rng, UTM, scale=0.01), "f8") == [2.0**-8, 2.0**-10, 2.0**-10]
    assert warned.messages == [
        "the step of positions is 0.00390625 in place of 0.000976562, because x reaches "
        "4.50001e+06, 2^31 steps at most: move the splats to the origin, or accept it by "
        "--step position=0.00390625"
    ]


def test_a_floater_is_told_and_limits_no_more_than_it_must(rng, tmp_path, warned):
    columns = cloud(rng)
    columns["y"][7] = 4000.0
    assert steps_of(tmp_path, columns) == [2.0**-9] * 3  # 2^21 / 512 = 4096
    assert not warned.messages
    columns["y"][7] = 20_000.0
    assert steps_of(tmp_path, columns) == [2.0**-6] * 3
    assert warned.messages == [
        "the step of positions is 0.015625 in place of 0.00195312, because y spans 20000, 2^21 "
        "steps at most: crop distant splats, or accept it by --step position=0.015625"
    ]
    warned.clear()
    assert steps_of(tmp_path, columns, position=0.015625) == [2.0**-6] * 3
    assert not warned.messages


def test_floaters_do_not_move_the_step_of_clouds_without_scales(rng, tmp_path, warned):
    columns = cloud(rng, scale=None)
    columns["z"][3] = 200.0
    assert steps_of(tmp_path, columns) == [2.0**-12] * 3  # at most 4 times that of the cube
    assert not warned.messages
    normal = rng.normal(size=100_000)
    assert usual_extent(normal) == np.ptp(normal)
    assert usual_extent(np.append(np.zeros(1000), 5.0)) == 5.0
    assert usual_extent(np.array([2.0])) == 0.0


def test_resolution():
    assert resolution(np.array([4.5e6, -4.5e6]), np.dtype("f4")) == 0.5
    assert resolution(np.array([4.5e6]), np.dtype("f8")) == 0.0
    assert resolution(np.append(np.full(1000, 1e6), [0.0] * 5), np.dtype("f4")) == 2.0**-4
    assert resolution(np.linspace(-1e6, 1e6, 1000), np.dtype("f4")) < 0.01


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.floats(-(2.0**50), 2.0**50, width=32)] * 3),
        min_size=1,
        max_size=9,
        unique=True,
    ),
    st.floats(-30, 30),
    st.sampled_from(["f4", "f8"]),
)
def test_every_cloud_is_packed(tmp_path_factory, points, scale, kind):
    columns = dict(zip("xyz", np.array(points).T, strict=True))
    columns |= {f"scale_{i}": np.full(len(points), scale) for i in range(3)}
    steps_of(tmp_path_factory.getbasetemp(), columns, kind, scale=1.0)


def test_splats_come_back_as_floats_wherever_they_can():
    values = np.array([[2**24 + 1, 5, -1, 2**30 + 1]], np.int32)
    columns = parse_ply(
        write_splats(QuantizedSplats([*"xyz", "id"], [0.25, 0.1, 3.0, 1.0], values))
    ).columns
    assert [column.dtype.str for column in columns.values()] == ["<f8", "<f4", "<f4", "<f8"]
    assert columns["x"][0] == (2**24 + 1) / 4
    assert columns["id"][0] == 2**30 + 1


def test_groups():
    assert [group_of(name) for name in ("x", "nz", "f_rest_12", "opacity", "scale_0", "7")] == [
        *("position", "normal", "f_rest", "opacity", "scale", "7")
    ]


def test_pack_says_the_steps_of_every_axis_and_warns_in_one_line(
    rng, tmp_path, monkeypatch, capsys, warned
):
    monkeypatch.chdir(tmp_path)
    columns = {name: column.astype("f4") for name, column in cloud(rng, UTM).items()}
    (tmp_path / "s.ply").write_bytes(pack_ply(PlyTable(columns)))
    assert main(["pack", "s.ply", "-o", "s.clgs"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("position: step 0.5 of x, 0.03125 of y, 0.00195312 of z, rounded by")
    assert main(["pack", "s.ply", "-o", "t.clgs", "--step", "position=1e-6"]) == 3
    assert capsys.readouterr().err.startswith("clgs: error: s.ply: property x: ")
    columns["z"][0] = 1e6
    (tmp_path / "s.ply").write_bytes(pack_ply(PlyTable(columns)))
    assert main(["pack", "s.ply", "-o", "t.clgs", "--step", "position=0.25"]) == 3
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "z spans" in said[0]
    assert "--step position=STEP" in said[0]


def test_steps_that_are_missing_or_name_nothing(rng, tmp_path):
    with pytest.raises(UsageError, match="--step weight: the file has no such property or group"):
        steps_of(tmp_path, cloud(rng), weight=1.0)
    with pytest.raises(UsageError, match="property odd has no default step; give --step odd=STEP"):
        steps_of(tmp_path, cloud(rng) | {"odd": np.zeros(1000)})
    with pytest.raises(UsageError, match=r"give --step odd=STEP --step \w+=STEP$"):
        steps_of(tmp_path, cloud(rng) | {"odd": np.zeros(1000), "even": np.zeros(1000)})


def test_points_that_are_no_splats_are_called_so(tmp_path, rng, capsys):
    path = tmp_path / "points.ply"
    path.write_bytes(pack_ply(PlyTable(cloud(rng) | {"odd": np.zeros(1000, np.float32)}, [])))
    words = ["pack", str(path), "-o", str(tmp_path / "p.clgs"), "--step", "odd=1"]
    assert main(words) == 0
    assert "property f_dc_0 is missing, so these are points, no 3DGS" in capsys.readouterr().err
    names = *POSITION, *DC, "opacity", *SCALE, *ROTATION, "f_rest_0", "f_rest_1", "f_rest_3"
    columns = {name: np.ones(3, np.float32) for name in names}
    path.write_bytes(pack_ply(PlyTable(columns)))
    assert main(["pack", str(path), "-o", str(tmp_path / "gap.clgs")]) == 0
    assert "property f_rest_2 is missing; f_rest_* count from 0" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_signalling_nans_are_one_line(tmp_path, rng, capsys):
    """Casting them is invalid to the processor, of which NumPy warns."""
    columns = {name: column.astype(">f4") for name, column in cloud(rng).items()}
    path = tmp_path / "s.ply"
    path.write_bytes(pack_ply(PlyTable(columns)))
    data = bytearray(path.read_bytes())
    data[-4:] = np.array(0x7FA00000, "<u4").tobytes()
    path.write_bytes(data)
    assert main(["pack", str(path), "-o", str(tmp_path / "s.clgs")]) == 3
    assert capsys.readouterr().err.count("\n") == 1
