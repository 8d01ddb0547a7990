"""Splats in a .clgs file: exact in steps, all of a voxel kept, every damage reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clgs.cli.main import main
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import write_container
from clgs.codec.splat_packing import QuantizedSplats, pack, quantize, sort_splats, unpack
from clgs.data.splats.ply import PlyTable, pack_ply, read_ply
from clgs.errors import CodecError
from tests.codec.container.damage import ENTRY, HEAD, contents, patched, rebuilt
from tests.codec.scenes import random_scene

NAMES = ["x", "y", "z", "f_dc_0", "opacity"]


def some_splats(rng: np.random.Generator, count: int = 300) -> QuantizedSplats:
    """Splats of which many share a voxel, and some are alike."""
    values = rng.integers(-3, 4, (count, 5)).astype(np.int32)
    return QuantizedSplats(NAMES, [0.5, 0.5, 0.5, 1 / 64, 0.1], values)


@pytest.mark.parametrize("count", [0, 1, 300])
def test_the_way_and_back_is_exact(rng: np.random.Generator, count: int) -> None:
    splats = some_splats(rng, count)
    found = unpack(pack(splats))
    assert (found.names, found.steps) == (splats.names, splats.steps)
    np.testing.assert_array_equal(found.values, sort_splats(splats.values))


def test_splats_of_a_voxel_keep_their_order() -> None:
    values = np.array(
        [[1, 1, 1, 9, 0], [0, 0, 0, 5, 0], [1, 1, 1, -9, 0], [1, 1, 1, 9, 1]], np.int32
    )
    found = unpack(pack(QuantizedSplats(NAMES, [1.0] * 5, values)))
    np.testing.assert_array_equal(found.values, values[[1, 0, 2, 3]])


def test_every_flip_and_cut_is_reported(rng: np.random.Generator) -> None:
    data = pack(some_splats(rng, 12))
    for at in range(len(data)):
        with pytest.raises(CodecError):
            unpack(data[:at])
        for bit in range(8):
            with pytest.raises(CodecError):
                unpack(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])


def test_streams_of_other_counts_are_refused_before_they_are_decoded(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = pack(some_splats(rng, 12))
    monkeypatch.setattr("clgs.codec.streams.declared_shape", lambda _: (1 << 22, 64))
    monkeypatch.setattr("clgs.codec.streams.decode_positions", None)
    with pytest.raises(CodecError, match=r"SPOS .*not the 12 rows of 3 that SPLT declares"):
        unpack(data)


def test_voxels_must_hold_all_splats_before_properties_are_decoded(
    rng: np.random.Generator,
) -> None:
    data = pack(some_splats(rng, 12))
    head = bytearray(contents(data)["SPLT"])
    head[0] += 1
    more = contents(pack(some_splats(rng, 13)))["SATR"]
    with pytest.raises(CodecError, match=r"SMUL .*the voxels do not hold all splats"):
        unpack(rebuilt(data, SPLT=bytes(head), SATR=more[:-4] + bytes(4)))


def test_unknown_optional_sections_are_skipped_but_checked(rng: np.random.Generator) -> None:
    data = pack(some_splats(rng, 12))
    longer = write_container({**contents(data), "NOTE": b"hello"})
    longer = patched(longer, HEAD + 4 * ENTRY + 4, b"\0")
    np.testing.assert_array_equal(unpack(longer).values, unpack(data).values)
    with pytest.raises(CodecError, match=r"section NOTE at byte .*checksum differs"):
        unpack(longer[:-1] + b"0")


def test_scenes_and_splats_are_told_apart(rng: np.random.Generator) -> None:
    packed = pack(some_splats(rng))
    for reader in (decode, describe):
        with pytest.raises(CodecError, match="holds splats; use `clgs unpack`"):
            reader(packed)
    with pytest.raises(CodecError, match="holds a scene; use `clgs decode`"):
        unpack(encode(random_scene(rng)))


@pytest.mark.parametrize(
    ("names", "steps", "message"),
    [
        (["x", "y", "z"], [1.0] * 3, "3 properties"),
        (["x", "y", "z", "z"], [1.0] * 4, "named twice"),
        (["x", "y", "z", "a b"], [1.0] * 4, "letters"),
        (["x", "y", "z", "é"], [1.0] * 4, "letters"),
        (["x", "y", "z", "a"], [1.0, 1.0, 1.0, 0.0], "step is 0.0"),
        (["x", "y", "z", "a"], [1.0, 1.0, 1.0, np.nan], "step is nan"),
    ],
)
def test_senseless_properties_are_refused(
    names: list[str], steps: list[float], message: str
) -> None:
    with pytest.raises(CodecError, match=message):
        pack(QuantizedSplats(names, steps, np.zeros((2, len(names)), np.int32)))


def test_values_that_no_step_suits_are_refused() -> None:
    assert quantize(np.array([0.26, -0.26]), 0.5, "x").tolist() == [1, -1]
    for value in (np.nan, np.inf, 3e9):
        with pytest.raises(CodecError, match=r"property opacity: .* in row 1"):
            quantize(np.array([0.0, value]), 1.0, "opacity")

    least = np.array([-(2.0**31), 2.0**31 - 1])
    np.testing.assert_array_equal(quantize(least, 1.0, "x"), least)


def test_too_wide_splats_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The library speaks of splats, the command of options."""
    values = np.zeros((2, 5), np.int32)
    values[1, 1] = 2**21
    message = r"^splats: y spans 2097153 steps, at most 2097152 fit; [^-]*$"
    with pytest.raises(CodecError, match=message):
        pack(QuantizedSplats(NAMES, [1.0] * 5, values))
    values[1, 1] -= 1
    np.testing.assert_array_equal(
        unpack(pack(QuantizedSplats(NAMES, [1.0] * 5, values))).values, values
    )
    source = tmp_path / "s.ply"
    splat_ply(rng, source)
    assert main(["pack", str(source), "-o", str(tmp_path / "s.clgs"), "--step", "x=1e-6"]) == 3
    said = capsys.readouterr().err
    assert said.startswith(f"clgs: error: {source}: splats: x spans ")
    assert said.endswith("give a larger --step position=STEP\n")


@pytest.mark.parametrize("column", ["x", "opacity"])
@pytest.mark.parametrize("value", [-4.5e6, 22.5, 1e25])
def test_the_step_that_is_named_in_a_refusal_works(
    rng: np.random.Generator,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    column: str,
    value: float,
) -> None:
    source, packed = tmp_path / "s.ply", str(tmp_path / "s.clgs")
    columns = splat_ply(rng, source).columns
    columns[column][7] = value
    source.write_bytes(pack_ply(PlyTable(columns)))
    command = ["pack", str(source), "-o", packed, "--step"]
    assert main([*command, f"{column}=1e-12"]) == 3
    said = capsys.readouterr().err
    start = f"clgs: error: {source}: property {column}: {value:g} in row 7 is beyond int32 in steps"
    assert said.startswith(f"{start} of 1e-12; a --step {column}=")
    assert main([*command, f"{column}={said.split(' of ')[2].split()[0]}"]) == 0


def test_values_that_no_step_holds(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, packed = tmp_path / "s.ply", str(tmp_path / "s.clgs")
    columns = splat_ply(rng, source).columns
    columns["x"][7] = 3e38
    source.write_bytes(pack_ply(PlyTable(columns)))
    for options, problem in (
        ([], f"x spans {np.ptp(columns['x']):g}, more than any step holds; correct or crop"),
        (["--step", "position=1e19"], "property x: 3e+38 in row 7 is beyond int32 in steps of"),
    ):
        assert main(["pack", str(source), "-o", packed, *options]) == 3
        said = capsys.readouterr().err
        assert said.startswith(f"clgs: error: {source}: {problem}")
        assert said.count("\n") == 1
        assert "--step" not in said


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((2, 4), np.int32), r"shape is \(2, 4\), \(N, 5\) is needed"),
        (np.zeros(5, np.int32), r"shape is \(5,\)"),
        (np.zeros((2, 5)), "dtype is float64, int32 is needed"),
    ],
)
def test_senseless_values_are_refused(values: np.ndarray, message: str) -> None:
    with pytest.raises(CodecError, match=message):
        pack(QuantizedSplats(NAMES, [1.0] * 5, values))


def splat_ply(rng: np.random.Generator, path: Path) -> PlyTable:
    """A PLY file of 50 splats."""
    names = ["x", "y", "z", "f_dc_0", "f_rest_0", "opacity", "scale_0", "scale_1", "scale_2"]
    names += ["rot_0", "rot_1", "rot_2", "rot_3"]
    columns = {name: rng.normal(size=50).astype(np.float32) for name in names}
    table = PlyTable(columns | {"red": rng.integers(0, 255, 50).astype(np.uint8)})
    path.write_bytes(pack_ply(table))
    return table


def test_commands(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, packed, target = (str(tmp_path / name) for name in ("s.ply", "s.clgs", "t.ply"))
    before = splat_ply(rng, Path(source)).columns
    assert main(["pack", source, "-o", packed, "--step", "scale=0.25"]) == 0
    assert "scale: step 0.25, rounded by at most 0.12" in capsys.readouterr().out
    assert main(["info", packed]) == 0
    assert main(["unpack", packed, "-o", target]) == 0
    after = read_ply(Path(target)).columns
    assert list(after) == list(before)
    steps = {"x": 0.125, "y": 0.125, "z": 0.125, "scale_1": 0.25, "opacity": 1 / 32, "red": 1.0}
    expected = [np.rint(before[name].astype(float) / step) * step for name, step in steps.items()]
    rows = sorted(zip(*expected, strict=True))
    assert sorted(zip(*(after[name] for name in steps), strict=True)) == rows
    rotation = np.stack([after[f"rot_{i}"] for i in range(4)], 1)
    np.testing.assert_allclose(np.linalg.norm(rotation, axis=1), 1, atol=4 / 512)
    assert (rotation[:, 0] >= 0).all()


def test_commands_refuse(rng: np.random.Generator, tmp_path: Path) -> None:
    source, packed = str(tmp_path / "s.ply"), str(tmp_path / "s.clgs")
    table = splat_ply(rng, Path(source))
    for step in ("scale", "scale=0", "scale=nan", "scale=-1", "=1", "scale=x"):
        with pytest.raises(SystemExit) as error:
            main(["pack", source, "-o", packed, "--step", step])
        assert error.value.code == 2
    assert main(["pack", source, "-o", packed, "--step", "weight=1"]) == 2
    assert main(["pack", str(tmp_path / "none.ply"), "-o", packed]) == 3
    Path(source).write_bytes(pack_ply(PlyTable(table.columns | {"odd": np.ones(50, np.float32)})))
    assert main(["pack", source, "-o", packed]) == 2
    assert main(["pack", source, "-o", packed, "--step", "odd=1"]) == 0
    assert main(["unpack", source, "-o", str(tmp_path / "t.ply")]) == 3
    table.columns["x"][3] = np.nan
    Path(source).write_bytes(pack_ply(table))
    assert main(["pack", source, "-o", packed, "--overwrite"]) == 3
