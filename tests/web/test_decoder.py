"""The page's decoder, built for this machine: integers, Gaussians and order as they should be."""

import ctypes
import re
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from clgs import constants
from clgs.codec import splat_packing
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.data.splats.gaussians import USUAL_SPREAD, scene_of_packed
from clgs.data.splats.integer_splats import read_splats
from clgs.data.splats.ply import PlyTable, pack_ply
from clgs.reference import mlp, neural
from clgs.reference.project import rotation_matrix
from clgs.scene.camera import UNKNOWN, PhotoRange
from tests.codec.container.damage import rebuilt
from tests.codec.scenes import random_scene
from tests.data.splats.test_gaussians import columns_of
from tests.ops.cases.splats import stored
from tests.web import native
from tests.web.scenes import quantized_scene, random_splats

pytestmark = native.NEEDS


@pytest.mark.slow
@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
@pytest.mark.parametrize("chunk", [16, 65_536])
def test_the_integers_are_those_of_the_file(library, level, chunk):
    data = encode(random_scene(np.random.default_rng(1), 3000), level=level, chunk=chunk)
    page = native.Page(library, data)
    expected = int.from_bytes(bytes.fromhex(describe(data)["content_hash"]), "little")
    assert page.hashes == [expected, expected]
    scene = decode(data).dequantize()
    found = page.array("positions", ctypes.c_float, scene.anchors.position.size)
    np.testing.assert_array_equal(found, scene.anchors.position.ravel())


def test_a_scene_without_anchors_has_no_gaussians(library):
    page = native.Page(library, encode(random_scene(np.random.default_rng(0), 0)))
    assert len(page.gaussians(np.zeros(3))["opacity"]) == 0
    assert len(page.order(np.ones(4))) == 0


def test_gaussians_are_those_of_the_reference(library):
    quantized, camera = quantized_scene(4000, 64)
    data = encode(quantized)
    scene = decode(data).dequantize()
    anchors = {name: array.astype(np.float64) for name, array in scene.anchors.items()}
    visible = np.arange(len(anchors["position"]), dtype=np.int32)
    weights, packed = scene.mlps.flat.astype(np.float64), camera.pack(0.2)
    made = mlp.forward(anchors["feature"], anchors["position"], visible, weights, packed)
    wanted = neural.forward(
        made.output, visible, anchors["position"], anchors["offset"], anchors["scaling"]
    )
    axes = rotation_matrix(wanted.rotation) * wanted.scale[:, None, :]
    drawn = wanted.opacity >= constants.ALPHA_CUT
    found = native.Page(library, data).gaussians(camera.centre)
    assert len(found["opacity"]) == drawn.sum()
    # Sums of 53 and 50 products in float32, and exponentials within 2e-7 of their values.
    np.testing.assert_allclose(found["mean"], wanted.mean[drawn], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found["opacity"], wanted.opacity[drawn], atol=1e-5)
    covariance = (axes @ axes.transpose(0, 2, 1))[drawn]
    largest = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    assert np.abs((found["covariance"] - covariance) / largest).max() < 1e-4
    # Red and green are half floats: 11 bits.
    np.testing.assert_allclose(found["color"], wanted.color[drawn], atol=2.0**-11)


SH_FIRST, SH_SECOND = 0.28209479177387814, 0.4886025119029199


@pytest.mark.parametrize(("count", "rest", "lattice"), [(5000, 45, 1), (900, 9, 1), (900, 0, 1000)])
def test_splats_are_those_of_the_file(library, count, rest, lattice):
    data = splat_packing.pack(random_splats(np.random.default_rng(4), count, rest, lattice))
    page = native.Page(library, data)
    assert page.hashes == [int(splat_packing.describe(data)["content_hash"], 16)] * 2
    wanted = splat_packing.unpack(data)
    values = dict(zip(wanted.names, (wanted.values * np.array(wanted.steps)).T, strict=True))
    centre = np.array([1.0, 2.0, -30.0])
    found = page.gaussians(centre)
    opacity = 1 / (1 + np.exp(-values["opacity"]))
    axes = np.stack([values[f"rot_{i}"] for i in range(4)], 1)
    drawn = (opacity >= constants.ALPHA_CUT) & (np.linalg.norm(axes, axis=1) > 0)
    np.testing.assert_allclose(found["opacity"], opacity[drawn], atol=1e-6)
    mean = np.stack([values[name] for name in "xyz"], 1)[drawn]
    np.testing.assert_allclose(found["mean"], mean, rtol=1e-6)
    turn = rotation_matrix((axes / np.maximum(np.linalg.norm(axes, axis=1), 1e-9)[:, None])[drawn])
    turn = turn * np.exp(np.stack([values[f"scale_{i}"] for i in range(3)], 1))[drawn][:, None, :]
    np.testing.assert_allclose(
        found["covariance"], turn @ turn.transpose(0, 2, 1), rtol=1e-4, atol=1e-5
    )
    direction = (mean - centre) / np.linalg.norm(mean - centre, axis=1, keepdims=True)
    if rest <= 9:  # the higher degrees have their own test
        for channel in range(3):
            color = 0.5 + SH_FIRST * values[f"f_dc_{channel}"][drawn]
            if rest == 9:
                x, y, z = direction.T
                first, second, third = (
                    values[f"f_rest_{3 * channel + k}"][drawn] for k in range(3)
                )
                color += SH_SECOND * (-y * first + z * second - x * third)
            np.testing.assert_allclose(found["color"][:, channel], np.maximum(color, 0), atol=2e-3)


@pytest.mark.parametrize(
    ("times", "place", "marked"),
    [(1.0, (0, 0, 0), False), (0.01, (0, 0, 0), True), (300.0, (5e5, 5.4e6, 1e2), False)],
)
def test_the_page_places_splats_as_the_reader_does(library, tmp_path, times, place, marked):
    gaussians = stored(np.random.default_rng(4), 1500)
    columns = columns_of(gaussians)
    for name, middle in zip("xyz", place, strict=True):
        columns[name] = columns[name].astype(np.float64) * times + middle
    path = tmp_path / "s.ply"
    path.write_bytes(pack_ply(PlyTable(columns, ["antialiased 1"] * marked)))
    data = splat_packing.pack(read_splats(path, {})[0])
    scene = scene_of_packed(splat_packing.unpack(data), path)
    page = native.Page(library, data)
    _, near, *_, learned, x, y, z = page.array("numbers", ctypes.c_double, 13)
    assert near == pytest.approx(scene.settings.near, rel=0.01)
    assert scene.gaussians.antialiased == marked
    assert learned == (0 if marked else constants.BLUR)
    assert np.abs(np.array([x, y, z]) - scene.transform.centre).max() < 0.1 * times
    assert np.array([x, y, z]).any() == np.any(place)
    position = page.array("positions", ctypes.c_float, 4500).reshape(-1, 3)
    wanted = scene.gaussians.mean + scene.transform.centre - np.array([x, y, z])
    np.testing.assert_allclose(position, wanted, atol=1e-6 * times)


def test_harmonics_are_orthonormal(library, tmp_path):
    source = tmp_path / "harmonics.c"
    source.write_text(
        '#include "harmonics.h"\nvoid all(const float *d, float *b, int n)\n'
        "{ for (int i = 0; i < n; i++) harmonics(d + 3 * i, b + 16 * i); }\n"
    )
    include, output = f"-I{native.ROOT / 'web/wasm/view'}", tmp_path / "harmonics.so"
    command = [native.COMPILER, "-shared", "-fPIC", include, str(source), "-o", str(output)]
    subprocess.run(command, check=True)
    height, weight = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) * np.pi / 8
    flat = np.sqrt(1 - height**2)
    around = [np.outer(flat, np.cos(angle)), np.outer(flat, np.sin(angle))]
    grid = np.stack([*around, np.repeat(height[:, None], 16, 1)], -1).reshape(-1, 3)
    directions = np.ascontiguousarray(grid, np.float32)
    basis = np.empty((len(directions), 16), np.float32)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (directions, basis)]
    ctypes.CDLL(str(output)).all(*pointers, len(directions))
    share = np.repeat(weight, 16) * np.pi / 8  # of the sphere's surface, exact to degree 6
    np.testing.assert_allclose(basis.T @ (basis * share[:, None]), np.eye(16), atol=1e-6)


def test_the_order_is_by_depth_and_leaves_out_what_is_near(library):
    quantized, camera = quantized_scene(4000, 64)
    page = native.Page(library, encode(quantized))
    mean = page.gaussians(camera.centre)["mean"]
    row = np.append(camera.rotation[2], camera.translation[2] - 3.9).astype(np.float32)
    depth = (mean[:, 0] * row[0] + mean[:, 1] * row[1]) + mean[:, 2] * row[2] + row[3]
    order = page.order(row)
    assert set(order) == set(np.flatnonzero(depth > np.float32(0.2)))
    assert (np.diff(depth[order]) <= 0).all()


def layer_ends(data):
    """The bytes of the file up to the end of each layer."""
    return [layer["end"] for layer in describe(data)["layers"]]


def assert_anchors(page, scene):
    """The page's anchors are those of ``scene``, in some order."""
    found = page.array("positions", ctypes.c_float, scene.anchors.position.size).reshape(-1, 3)
    wanted = scene.dequantize().anchors.position
    assert page.array("numbers", ctypes.c_double, 1)[0] == len(wanted)
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, wanted.tolist()))


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [32, 65_536])
def test_layers_are_shown_while_they_come(library, chunk):
    data = encode(random_scene(np.random.default_rng(4), 1500), chunk=chunk, layers=4)
    ends, (_, front) = layer_ends(data), native.sizes(library, data)
    page = native.Page(library, data, front)
    assert page.layers == (4, 0)
    for count, end in enumerate(ends, 1):
        page.arrive(end - 1)
        assert page.layers == (4, count - 1)
        page.arrive(end)
        assert page.layers == (4, count)
        assert page.hashes[0] == page.hashes[1]
        assert_anchors(page, decode(data, layers=count))
        assert len(page.gaussians(np.zeros(3))["opacity"]) > 0
    whole = native.Page(library, data).gaussians(np.ones(3))
    plain = native.Page(library, encode(decode(data))).gaussians(np.ones(3))
    for name in whole:  # the same Gaussians, those of the most important anchors first
        order = [np.lexsort(one["mean"].T) for one in (whole, plain)]
        np.testing.assert_array_equal(whole[name][order[0]], plain[name][order[1]])


def test_sizes_are_known_from_the_table(library):
    for layers in (None, 3):
        data = encode(random_scene(np.random.default_rng(4), 200), chunk=64, layers=layers)
        size, front = native.sizes(library, data)
        assert size == len(data)
        if layers:
            size = int.from_bytes(data[data.index(b"BODY") + 8 :][:8], "little")  # where it begins
        assert front == size
        assert native.sizes(library, data[:100]) == (0, 0)
    with pytest.raises(ValueError, match=r"no \.clgs file"):
        native.sizes(library, b"<!doctype html>" * 99)


def test_a_cut_file_in_layers_is_the_scene_of_those_that_are_whole(library):
    data = encode(random_scene(np.random.default_rng(4), 900), chunk=64, layers=3)
    ends = layer_ends(data)
    page = native.Page(library, data[: ends[1] + 7])
    assert page.layers == (3, 2)
    assert_anchors(page, decode(data, layers=2))
    assert native.Page(library, data[: ends[0] - 1]).layers == (3, 0)
    with pytest.raises(ValueError, match="copy"):
        native.Page(library, data[: native.sizes(library, data)[1] - 1])


@pytest.mark.parametrize("kind", ["scene", "layers", "splats"])
def test_damaged_files_are_refused_in_words(library, kind):
    layers = 3 if kind == "layers" else None
    data = encode(random_scene(np.random.default_rng(2), 300), layers=layers)
    if kind == "splats":
        data = splat_packing.pack(random_splats(np.random.default_rng(2), 300, 0, 5))
    with pytest.raises(ValueError, match=r"no \.clgs file"):
        native.Page(library, b"PK" + data)
    rng = np.random.default_rng(3)
    for at in rng.integers(16, len(data), 200).tolist():
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(ValueError, match="copy"):
            native.Page(library, bytes(damaged))
    front = native.sizes(library, data)[1]  # cut later, a file in layers is a coarser scene
    for size in rng.integers(0, front, 100).tolist():
        with pytest.raises(ValueError, match=r"copy|no \.clgs file"):
            native.Page(library, data[:size])


PHOTOS = PhotoRange(300.0, 310.5, 0.25, -1.0, 2.0, 3.0, 4.5)


@pytest.mark.parametrize("layers", [None, 2])
@pytest.mark.parametrize("photos", [UNKNOWN, PHOTOS])
def test_it_knows_the_photos_that_the_file_names(library, layers, photos):
    scene = random_scene(np.random.default_rng(4), 300)
    scene.settings = replace(scene.settings, photos=photos)
    page = native.Page(library, encode(scene, layers=layers))
    numbers = page.array("numbers", ctypes.c_double, 20)
    assert tuple(numbers[13:]) == tuple(photos)
    assert numbers[9] == scene.settings.blur


@pytest.mark.parametrize("wrong", [{"x": np.nan}, {"nearest": -1.0}, {"least_focal": 311.0}])
def test_photos_that_cannot_be_are_refused(library, wrong):
    scene = random_scene(np.random.default_rng(4), 300)
    scene.settings = replace(scene.settings, photos=PHOTOS)
    numbers = struct.pack("<7d", *PHOTOS._replace(**wrong))
    with pytest.raises(ValueError, match="out of range"):
        native.Page(library, rebuilt(encode(scene), PHOT=numbers))


def test_it_has_the_constants_of_the_method():
    text = "".join(path.read_text() for path in (native.ROOT / "web/wasm").rglob("*.h"))
    numbers = dict(re.findall(r"\b([A-Z_]+) = (\d+)", text))
    names = {"OFFSETS": "K_OFFSETS", "FEATURES": "FEATURE_DIM", "HIDDEN": "HIDDEN_DIM"}
    for own, name in names.items():
        assert int(numbers[own]) == getattr(constants, name)
    limit = re.search(r"LOG_SCALE_LIMIT ([\d.]+)f", text)
    assert float(limit[1]) == constants.LOG_SCALE_LIMIT
    paths = "web/wasm/page.c", "web/wasm/file/splats.c"
    source = "".join((native.ROOT / path).read_text() for path in paths)
    spread = [
        float(re.search(rf"{end}_SPREAD ([\d.]+)", source)[1]) for end in ("LEAST", "GREATEST")
    ]
    assert tuple(spread) == USUAL_SPREAD
    for name in ("NEAR_PLANE", "ALPHA_MAX", "BLUR"):
        found = re.search(rf"#define {name}(?:_OF_SPLATS)? ([\d.]+)", source)
        assert float(found[1]) == getattr(constants, name)
    assert "ALPHA_CUT_OF_SPLATS (1.0 / 255.0)" in source
    assert constants.ALPHA_CUT == 1.0 / 255.0
