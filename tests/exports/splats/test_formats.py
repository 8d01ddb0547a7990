"""Files of ordinary Gaussians, read again by a few lines of each format's description."""

import gzip
import io
import json
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from clgs.data.splats.gaussians import load_splats
from clgs.errors import DataError
from clgs.exports.glb import EXTENSION, encode_glb
from clgs.exports.splats import sog
from clgs.exports.splats.ply import encode_ply
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz
from clgs.scene.scene import SceneTransform
from tests.exports.splats.cases import differences, gaussians
from tests.exports.test_glb import parse

ENCODERS = (encode_ply, encode_spz, encode_sog, encode_glb)


@pytest.mark.parametrize("encode", ENCODERS)
def test_the_same_gaussians_give_the_same_bytes(encode):
    assert encode(gaussians()).data == encode(gaussians()).data


@pytest.mark.parametrize("degree", range(4))
def test_ply_is_read_again_bit_for_bit(tmp_path, degree):
    before = gaussians(degree)
    path = tmp_path / "x.ply"
    path.write_bytes(encode_ply(before).data)
    after = load_splats(path).gaussians
    assert after.degree == degree
    for name, array in before.items():
        assert np.array_equal(getattr(after, name), array), name


@pytest.mark.parametrize("degree", range(4))
def test_spz_header_size_and_rounding(degree):
    before = gaussians(degree)
    encoded = encode_spz(before)
    data = gzip.decompress(encoded.data)
    head = struct.unpack("<IIIBBBB", data[:16])
    assert head[:4] == (0x5053474E, 3, 500, degree)
    assert len(data) == 16 + 500 * (9 + 1 + 3 + 3 + 4 + 3 * ((degree + 1) ** 2 - 1))
    first = int.from_bytes(data[16:19], "little", signed=True) / 2 ** head[4]
    assert first == encoded.gaussians.mean[0, 0]
    apart = differences(before, encoded.gaussians)
    assert apart["mean"] <= 0.5 / 2 ** head[4] + 1e-6
    assert apart["log_scale"] <= 0.5 / 16 + 1e-6
    assert apart["sh"] <= 0.5 / (0.15 * 255) + 1e-6  # the base color's step is the largest
    assert apart["opacity"] <= 0.5 / 255 + 1e-6
    # three components off by half of sqrt(1/2) / 511 each
    assert apart["rotation"] <= 3 * (0.5 * 0.5**0.5 / 511) ** 2 * 2


def test_spz_refuses_coordinates_without_room():
    far = gaussians()
    far.mean[3, 1] = 5e6
    said = r"5e\+06: too large for \.spz; write \.ply, or give --units scene"
    with pytest.raises(DataError, match=said):
        encode_spz(far)


def test_spz_tells_of_sizes_that_it_cannot_hold(caplog):
    whole = gaussians()
    encode_spz(whole)
    assert caplog.records == []
    sizes = whole.log_scale.copy()
    sizes[1] = 80.0
    stored = encode_spz(replace(whole, log_scale=sizes)).gaussians
    assert stored.log_scale[1] == pytest.approx(5.94, abs=0.01)
    assert "1 Gaussians are larger than the 379 units that .spz can hold" in caplog.text
    encode_spz(replace(whole, log_scale=whole.log_scale - 6))
    assert "% of the Gaussians are smaller than the 5e-05 units that .spz can hold" in caplog.text


def test_numbers_that_a_format_cannot_hold_are_cut_without_numpy_saying_so(caplog, recwarn):
    whole = gaussians()
    whole.sh[2, 0, 1], whole.log_scale[1] = 1e38, 1e30
    stored = encode_spz(whole).gaussians
    assert stored.sh[2, 0, 1] == pytest.approx(3.33, abs=0.01)
    assert "1 Gaussians are brighter or darker than .spz can hold" in caplog.text
    data = encode_glb(whole).data
    assert np.float32(np.inf).tobytes() not in data
    assert not recwarn.list


def test_spz_keeps_the_largest_coordinate():
    wide = gaussians()
    for largest in (0.3, 1.0, 1000.0, 4194303.0):
        wide.mean[0, 0] = largest
        stored = encode_spz(wide).gaussians.mean[0, 0]
        assert abs(stored - largest) <= 1e-6 * max(largest, 1.0)


def test_sog_is_what_its_description_says():
    encoded = encode_sog(gaussians())
    archive = zipfile.ZipFile(io.BytesIO(encoded.data))
    meta = json.loads(archive.read("meta.json"))
    assert (meta["version"], meta["count"], meta["shN"]["bands"]) == (2, 500, 3)

    def pixels(name: str) -> np.ndarray:
        return np.asarray(Image.open(io.BytesIO(archive.read(name)))).astype(int)

    low, high = (pixels(name).reshape(-1, 3)[:500] for name in meta["means"]["files"])
    least, most = (np.array(meta["means"][name]) for name in ("mins", "maxs"))
    logs = least + (most - least) * (low + 256 * high) / 65535
    mean = np.sign(logs) * (np.exp(np.abs(logs)) - 1)
    assert np.allclose(mean, encoded.gaussians.mean, atol=1e-5)
    book = np.array(meta["scales"]["codebook"])
    scale = book[pixels("scales.webp").reshape(-1, 3)[:500]]
    assert np.allclose(scale, encoded.gaussians.log_scale)
    label = pixels("shN_labels.webp").reshape(-1, 3)[:500] @ [1, 256, 0]
    assert label.max() < meta["shN"]["count"]
    centroids = pixels("shN_centroids.webp")
    assert centroids.shape[1] == 64 * 15
    rest = np.array(meta["shN"]["codebook"])[centroids.reshape(-1, 15, 3)[label]]
    assert np.allclose(rest, encoded.gaussians.sh[:, 1:])


def test_sog_rounds_little():
    before = gaussians()
    apart = differences(before, encode_sog(before).gaussians)
    assert apart["mean"] <= 0.002
    assert apart["log_scale"] <= 6 / 64
    assert apart["opacity"] <= 0.5 / 255 + 1e-6
    assert apart["rotation"] <= 3 * (0.5 * 2**0.5 / 255) ** 2 * 2


def test_a_single_gaussian_and_equal_ones_are_exported():
    for count in (1, 3):
        few = gaussians(count=4).map(lambda array, n=count: array[:1].repeat(n, axis=0))
        for encode in ENCODERS:
            assert len(encode(few).gaussians) == count


def test_tables_hold_what_is_there():
    few = np.array([0.5, -2.0, 0.5, 7.0], np.float32)
    table = sog.make_table(few)
    assert len(table) == 256
    assert np.allclose(table[sog.nearest(table, few)], few, atol=0.04)


@pytest.mark.parametrize("outlier", [20.0, 1e4, -1e30])
def test_tables_of_values_with_an_outlier_are_as_fine(rng, outlier):
    values = rng.normal(size=(9000, 3)).astype(np.float32)
    usual = sog.make_table(values)
    error = np.abs(usual[sog.nearest(usual, values)] - values)
    values[4, 1] = outlier
    table = sog.make_table(values)
    found = np.abs(table[sog.nearest(table, values)] - values)
    assert np.median(found) < 1.5 * np.median(error)
    assert found.max() < 4 * error.max()


def test_palettes_hold_repeated_sets_exactly():
    rng = np.random.default_rng(3)
    sets = rng.integers(-3, 4, (10, 8, 3)).astype(np.float32)
    palette = sog.make_palette(sets[rng.integers(0, 10, 4000)])
    assert len(palette.entries) <= sog.MAX_PALETTE
    error = palette.values() - sets[np.argmin(np.abs(
        palette.values()[:, None] - sets).sum(axis=(2, 3)), axis=1)]  # fmt: skip
    assert np.abs(error).max() <= 0.05


def test_glb_is_what_its_specification_says():
    before = gaussians()
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    document, binary = parse(encode_glb(before, turn=turn).data)
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION]["colorSpace"] == "srgb_rec709_display"
    assert document["nodes"][0]["matrix"] == [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]

    def attribute(name: str) -> np.ndarray:
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        kind = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        return np.frombuffer(part, kind).reshape(accessor["count"], -1)

    assert np.array_equal(attribute("POSITION"), before.mean)
    assert np.allclose(attribute(f"{EXTENSION}:SCALE"), np.exp(before.log_scale))
    unit = before.rotation / np.linalg.norm(before.rotation, axis=1, keepdims=True)
    assert np.allclose(attribute(f"{EXTENSION}:ROTATION"), unit[:, [1, 2, 3, 0]], atol=1e-6)
    opacity = attribute(f"{EXTENSION}:OPACITY")
    assert 0 <= opacity.min() <= opacity.max() <= 1
    for degree, number, place in ((0, 0, 0), (1, 2, 3), (2, 0, 4), (3, 6, 15)):
        name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"
        assert np.array_equal(attribute(name), before.sh[:, place])


@pytest.mark.parametrize("encode", ENCODERS)
@pytest.mark.parametrize("place", [(3.0, -1.0, 0.5), (5e5, 5.4e5, 120.0)])
def test_units_of_the_world(tmp_path, encode, place):
    """Positions that are far away keep what the format can hold."""
    before = gaussians()
    transform = SceneTransform(place, 0.25)
    encoded = encode(before, transform)
    apart = differences(encoded.gaussians, before)
    far = place[0] > 100
    limits = {encode_spz: 0.3 if far else 1e-4, encode_sog: 0.01}
    assert apart["mean"] <= limits.get(encode, 2e-6)
    if encode is encode_glb:
        return
    path = tmp_path / "x.bin"
    path.write_bytes(encoded.data)
    scene = load_splats(path)
    world = scene.transform.to_world(scene.gaussians.mean.astype(np.float64))
    assert np.abs(transform.to_scene(world) - encoded.gaussians.mean).max() <= 2e-6
    size = np.exp(scene.gaussians.log_scale - encoded.gaussians.log_scale)
    assert np.allclose(size, 1 / 0.25, rtol=1e-5)
    assert (max(scene.transform.centre) > 100) == far


def test_glb_puts_far_splats_in_their_place():
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    document, _ = parse(encode_glb(gaussians(), SceneTransform((5e5, 5.4e5, 120.0)), turn).data)
    matrix = np.reshape(document["nodes"][0]["matrix"], (4, 4)).T
    assert np.array_equal(matrix[:3, :3], turn)
    assert np.allclose(turn.T @ matrix[:3, 3], [5e5, 5.4e5, 120.0], atol=1)
    accessor = document["accessors"][0]
    assert np.abs([accessor["min"], accessor["max"]]).max() < 20
