"""The decoder made from FORMAT.md reads what clgs writes, and refuses what clgs refuses."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from clgs import _codec, codec
from clgs.codec import chunks, row_coder
from clgs.codec.attribute_model import KNOWN, MIXED, SIDED, empty_model
from clgs.codec.meta import LEVELS
from clgs.codec.reader import SceneReader
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.codec.sections import BytesSource, read_table
from clgs.codec.splat_packing import QuantizedSplats, is_splats, pack, unpack
from clgs.errors import CodecError
from clgs.scene.mlps import MLP_SIZE, Mlps
from codec_c.reader.attributes import Attributes
from codec_c.reader.files import CHANNELS, Scene, decode_attributes, decode_positions, read_file
from tests.codec.container.damage import contents, rebuilt
from tests.codec.container.mutations import changed, damaged_file
from tests.codec.samples import sealed
from tests.codec.scenes import GOLDEN, random_scene

QUICK = "single"
"""The golden file of the default run: most of a file's time goes to weights that are no zeros."""
SLOW = pytest.mark.slow
OTHERS = sorted({path.stem for path in GOLDEN.glob("*.clgs")} - {QUICK})


def assert_scene(data: bytes) -> None:
    """Both decoders read the same integers, weights and settings."""
    scene, found = decode(data), read_file(data)
    assert isinstance(found, Scene)
    anchors, meta, settings = scene.anchors, found.meta, scene.settings
    offset = anchors.offset.reshape(-1, CHANNELS["OFFS"])
    rows = {"OFFS": offset, "FEAT": anchors.feature, "SCAL": anchors.scaling}
    np.testing.assert_array_equal(found.positions, anchors.position)
    for tag, values in rows.items():
        np.testing.assert_array_equal(found.attributes[tag], values)
    np.testing.assert_array_equal(found.weights.view("<u4"), scene.mlps.flat.view(np.uint32))
    assert meta.q == tuple(vars(scene.scales).values())
    assert (meta.centre, meta.scale) == (scene.transform.centre, scene.transform.scale)
    for name in vars(settings).keys() - {"photos"}:  # of a section that the reader skips
        assert getattr(meta, name) == getattr(settings, name)


@pytest.mark.parametrize("name", [QUICK, *(pytest.param(one, marks=SLOW) for one in OTHERS)])
def test_golden_files(name: str) -> None:
    assert_scene((GOLDEN / f"{name}.clgs").read_bytes())


def small_scene(count: int = 20):
    """Few weights: those of one matrix."""
    scene = random_scene(np.random.default_rng(4), count)
    scene.mlps = Mlps(np.zeros(MLP_SIZE, np.float32))
    scene.mlps.head("color")["output_bias"][:] = np.arange(-15, 15) / 8
    return scene


@pytest.mark.parametrize("level", LEVELS)
def test_scenes_of_every_level_with_weights_as_multiples(level: str) -> None:
    data = encode(small_scene(), level)
    assert contents(data)["MLPS"][0] == 2
    assert_scene(data)


@pytest.mark.slow
def test_weights_as_planes_of_bytes() -> None:
    data = encode(decode((GOLDEN / f"{QUICK}.clgs").read_bytes()), mlp="float32")
    assert contents(data)["MLPS"][0] == 1
    assert_scene(data)


def test_weights_as_floats() -> None:
    scene = small_scene()
    plain = b"\0" + scene.mlps.flat.astype("<f4").tobytes()
    assert_scene(rebuilt(encode(scene), MLPS=plain))


def test_two_groups_of_chunks() -> None:
    scene = small_scene(1500)
    for name in ("offset", "feature", "scaling"):
        getattr(scene.anchors, name)[:] = 3
    data = encode(scene, "default", 16)
    assert int.from_bytes(contents(data)["CHNK"][4:8], "little") > 64
    assert_scene(data)


def test_layers_of_whole_files_and_of_files_that_are_cut() -> None:
    data = encode(small_scene(40), chunk=16, layers=3)
    assert_scene(data)
    assert read_file(data).layers == (3, 3)
    ends = [layer["end"] for layer in describe(data)["layers"]]
    for size, there in ((ends[0], 1), (ends[1] - 1, 1), (ends[1], 2), (ends[2] - 1, 2)):
        assert read_file(data[:size]).layers == (there, 3)
        with pytest.warns(UserWarning, match=f"{there} of 3"):
            assert_scene(data[:size])
    assert_alike(read_by_clgs, read_by_the_document, data[: ends[0] - 1])


@pytest.mark.parametrize("level", ["default", pytest.param("max", marks=SLOW)])
def test_details_of_whole_files_and_of_files_that_are_cut(level: str) -> None:
    data = encode(small_scene(40), level, chunk=16, layers=3, details=True)
    assert_scene(data)
    assert read_file(data).layers == (3, 3)
    first, second, last = (layer["end"] for layer in describe(data)["layers"])
    for size, there in ((first, 1), (second - 1, 1), (second, 2), (last - 1, 2)):
        assert read_file(data[:size]).layers == (there, 3)
        with pytest.warns(UserWarning, match=f"{there} of 3"):
            assert_scene(data[:size])


@pytest.mark.slow
def test_details_in_eight_lanes_of_which_some_channels_are_mixed() -> None:
    scene = small_scene(3000)
    scene.anchors = sort_anchors(scene.anchors)
    scene.anchors.feature[:, 8:], scene.anchors.offset[:], scene.anchors.scaling[:] = 0, 2, 1
    scene.anchors.feature[:, 7] = np.arange(len(scene.anchors)) // 40 % 7 - 3
    data = encode(scene, "max", chunk=65536, layers=2, details=True)
    models = details_of(data)
    assert {int(coder) for coder in models["FEAT"].tables["coder"]} == {0, MIXED, KNOWN, SIDED}
    assert_scene(data)


def details_of(data: bytes) -> dict[str, row_coder.RowModel]:
    """The models of the details of a file."""
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))
    return {tag: reader.detail_model(tag) for tag in CHANNELS}


@pytest.mark.parametrize("step", [1, 5, 255])
def test_details_of_other_steps(step: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "STEP", step)
    scene = small_scene(9)
    scene.anchors.feature[:, ::7] = scene.anchors.feature[:, ::7] * 999_999 + 77
    data = encode(scene, chunk=16, layers=2, details=True)
    assert contents(data)["DETL"][:4] == struct.pack("<I", step)
    assert_scene(data)


def test_a_sided_channel_that_looks_at_itself_is_refused() -> None:
    model = empty_model(2)
    model["coder"], model["frequency"][0] = (KNOWN, SIDED), 0
    model["taps"][1], model["tap"][1, 0] = 1, (0, 0, -768)
    known = np.array([True, False])
    for channel, row, weight, fine in ((0, 3, 0, True), (1, -1, 0, False), (0, 0, 5, False)):
        model["tap"][1, 0, :2], model["weight"][1, 0] = (channel, row), weight
        if fine:
            header = _codec.attributes_header(model)
            assert Attributes(header, 2, known.tolist()).channels[1].sided
            continue
        with pytest.raises(ValueError, match="the array cannot be encoded"):
            _codec.attributes_header(model)


def test_known_channels_that_are_no_details_are_refused() -> None:
    model = empty_model(1)
    model["coder"], model["frequency"] = KNOWN, 0
    header = _codec.attributes_header(model)
    reader = Attributes(header, 1, [True])
    assert reader.decode(b"", 2, None, np.array([[7], [-9]])).tolist() == [[7], [-9]]
    plain = codec.encode_attributes(np.zeros((2, 1), np.int32), "paper")
    data = sealed(plain[:10] + struct.pack("<II", len(header), 0) + header)
    for decode_rows in (codec.decode_attributes, decode_attributes):
        with pytest.raises((CodecError, ValueError), match="other channels are known"):
            decode_rows(data)
    model["coder"] = MIXED
    for other in (model, empty_model(1)):
        header = _codec.attributes_header(other)
        with pytest.raises(ValueError, match="other channels are known"):
            Attributes(header, 1, [True])
        with pytest.raises(ValueError, match="other channels are known"):
            row_coder.read(header, 1, np.array([True]))


def rows_of(spread: float, rows: int) -> np.ndarray:
    """Three channels, of which one differs little from another and one is smooth."""
    value = np.rint(np.random.default_rng(5).laplace(spread / 3, spread, (rows, 3)))
    value[:, 1] += value[:, 0]
    value[:, 2] = np.cumsum(value[:, 0])
    return np.clip(value, -(2**31), 2**31 - 1).astype(np.int32)


@pytest.mark.parametrize("level", LEVELS)
def test_attributes_in_eight_lanes(level: str) -> None:
    value = rows_of(2, 2100)
    found = decode_attributes(codec.encode_attributes(value, level))
    np.testing.assert_array_equal(found, value)


def some_splats() -> QuantizedSplats:
    values = np.random.default_rng(6).integers(-3, 4, (90, 5)).astype(np.int32)
    return QuantizedSplats([*"xyzab"], [0.5] * 5, values)


def test_splats() -> None:
    data = pack(some_splats())
    mine, found = unpack(data), read_file(data)
    assert (mine.names, mine.steps) == (found.names, found.steps)
    np.testing.assert_array_equal(mine.values, found.integers)


def outcome(function: Callable[[bytes], object], data: bytes) -> object:
    """What a decoder makes of some bytes; None if it refuses them."""
    try:
        return function(data)
    except (CodecError, ValueError):
        return None


def assert_alike(ours: Callable[[bytes], object], other: Callable[[bytes], object], data: bytes):
    """Both decoders refuse the bytes, or read the same array."""
    one, two = outcome(ours, data), outcome(other, data)
    assert (one is None) == (two is None), data.hex()
    if one is not None:
        np.testing.assert_array_equal(one, two)


def streams() -> list[tuple]:
    """Short streams, with both decoders."""
    rng = np.random.default_rng(7)
    clouds = [np.unique(rng.integers(0, n, (n, 3)), axis=0) for n in (1, 4, 12)]
    clouds += [np.array([[0, 0, 0], [2**20, 1, 2**19]]), 7 * clouds[1]]
    found = [
        (codec.decode_positions, decode_positions, codec.encode_positions(cloud))
        for cloud in clouds
    ]
    kinds = [("paper", 1, 20), ("paper", 1e6, 9), ("default", 1e9, 9), ("default", 1, 100)]
    for level, spread, rows in (*kinds, ("max", 20, 300)):
        data = codec.encode_attributes(rows_of(spread, rows), level)
        found.append((codec.decode_attributes, decode_attributes, data))
    return found


def files() -> list[bytes]:
    """Small files of scenes, in several chunks, and of splats."""
    scenes = [encode(small_scene(), level, 16) for level in LEVELS]
    scenes += [encode(small_scene(), level, 16, layers=3) for level in ("default", "paper")]
    scenes += [encode(small_scene(), level, 16, layers=2, details=True) for level in LEVELS]
    return scenes + [pack(some_splats(), level) for level in LEVELS]


def read_by_clgs(data: bytes) -> np.ndarray:
    """All integers of a file, and the bits of its weights, as one row."""
    if is_splats(data):
        return unpack(data).values.ravel()
    scene = decode(data)
    anchors = [array.ravel() for _, array in scene.anchors.items()]
    return np.concatenate([*anchors, scene.mlps.flat.view(np.int32)])


def read_by_the_document(data: bytes) -> np.ndarray:
    """The same."""
    found = read_file(data)
    if not isinstance(found, Scene):
        return found.integers.ravel()
    rows = [array.ravel() for array in found.attributes.values()]
    return np.concatenate([found.positions.ravel(), *rows, found.weights.view("<i4")])


@pytest.mark.parametrize(("seed", "count"), [(0, 30), pytest.param(1, 600, marks=SLOW)])
def test_damaged_files_are_refused_by_both_decoders_or_read_alike(seed: int, count: int) -> None:
    rng, cases = np.random.default_rng(seed), files()
    for _ in range(count):
        assert_alike(read_by_clgs, read_by_the_document, damaged_file(rng, cases))


def test_every_byte_of_the_directory_is_checked_alike() -> None:
    data = bytearray(encode(small_scene()))
    end = 16 + 32 * int.from_bytes(data[12:16], "little")  # its checksum follows
    for at in range(8, end):
        one = data.copy()
        one[at] ^= 1
        one[end : end + 4] = struct.pack("<I", _codec.crc32c(bytes(one[:end])))
        assert_alike(read_by_clgs, read_by_the_document, bytes(one))


@pytest.mark.parametrize(("seed", "count"), [(0, 60), pytest.param(1, 1000, marks=SLOW)])
def test_damaged_streams_with_right_checksums_are_refused_or_read_alike(
    seed: int, count: int
) -> None:
    rng, cases = np.random.default_rng(seed), streams()
    for _ in range(count):
        ours, other, data = cases[rng.integers(len(cases))]
        body = changed(rng, data[:-4])
        assert_alike(ours, other, body + struct.pack("<I", _codec.crc32c(body)))


@pytest.mark.slow
def test_the_command_says_in_a_line_what_is_wrong(tmp_path):
    (tmp_path / "no.clgs").write_bytes(b"not one")
    reader = [sys.executable, "-m", "codec_c.reader"]
    for names, said in (
        ([], "name one file: python -m codec_c.reader FILE.clgs"),
        (["none.clgs"], "none.clgs: No such file or directory"),
        ([tmp_path / "no.clgs"], f"{tmp_path / 'no.clgs'}: not a .clgs file"),
    ):
        done = subprocess.run([*reader, *names], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (1, f"error: {said}\n")


def test_the_command_ends_quietly_if_nobody_reads_on(tmp_path):
    (tmp_path / "s.clgs").write_bytes(encode(small_scene()))
    command = [sys.executable, "-u", "-m", "codec_c.reader", tmp_path / "s.clgs"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        assert running.stderr.read() == b""
    assert running.returncode == 0
