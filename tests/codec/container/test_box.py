"""A box of a scene: the anchors of a whole decode, from few of the bytes."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.scene_decoder import EVERYWHERE, decode, decode_box
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import BytesSource, FileSource
from clgs.errors import CodecError, UsageError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.region import Box
from clgs.scene.scene import SceneTransform
from tests.codec.scenes import GOLDEN, assert_same, random_scene


@pytest.fixture(scope="module")
def scene():
    scene = random_scene(np.random.default_rng(8), 3000)
    scene.transform = SceneTransform((0.1, -2.0, 1e4), 0.7)
    scene.scales = QuantizationScales(3.0)
    return scene


@pytest.fixture(scope="module")
def file(scene):
    return encode(scene, chunk=64)


def world(scene):
    return scene.transform.to_world(scene.anchors.position / np.float64(scene.scales.position))


def expected(scene, box):
    points = world(scene)
    kept = ((points >= box.lower) & (points < box.upper)).all(axis=1)
    a = scene.anchors
    arrays = (a.position, a.offset, a.feature, a.scaling)
    return replace(scene, anchors=QuantizedAnchors(*(array[kept] for array in arrays)))


def test_a_box_has_the_anchors_of_the_whole(file, rng):
    whole = decode(file)
    points = world(whole)
    for _ in range(12):
        # Ends on positions of anchors: the lower one belongs to the box, the upper one does not.
        ends = np.sort(points[rng.integers(len(points), size=2)], axis=0)
        ends[1] += (ends[0] == ends[1]) * 0.5
        box = Box(tuple(ends[0]), tuple(ends[1]))
        part = decode_box(BytesSource(file), box)
        assert_same(part, expected(whole, box))
    assert_same(decode_box(BytesSource(file), EVERYWHERE), whole)


def test_nothing_in_the_box(file):
    part = decode_box(BytesSource(file), Box((1e9, 0, 0), (2e9, 1, 1)))
    assert len(part.anchors) == 0
    assert_same(part, expected(decode(file), Box((1e9, 0, 0), (2e9, 1, 1))))


@pytest.mark.slow
def test_only_what_is_needed_is_read_and_checked(file, rng):
    points = world(decode(file))
    box = Box((-np.inf,) * 3, (float(np.quantile(points[:, 0], 0.1)), np.inf, np.inf))
    source = FileSource(io.BytesIO(file))
    part = decode_box(source, box)
    share = len(part.anchors) / len(points)
    assert 0.05 < share < 0.15
    fixed = 4000 + len(decode(file).mlps.flat) // 40 * 4  # header, CHNK; MLPS as random_scene's
    assert source.bytes_read < 0.6 * (len(file) - fixed) + fixed
    seen = np.zeros(len(file), bool)

    class Watched(FileSource):
        def read(self, offset, length):
            seen[offset : offset + length] = True
            return super().read(offset, length)

    decode_box(Watched(io.BytesIO(file)), box)
    assert seen.sum() <= source.bytes_read < len(file)
    for at in rng.choice(np.flatnonzero(seen), 15):
        with pytest.raises(CodecError):
            decode_box(BytesSource(flipped(file, at)), box)
    for at in rng.choice(np.flatnonzero(~seen), 15):
        assert_same(decode_box(BytesSource(flipped(file, at)), box), part)


@pytest.mark.parametrize("name", sorted(path.stem for path in GOLDEN.glob("*.clgs")))
def test_no_byte_is_read_twice(name):
    data = (GOLDEN / f"{name}.clgs").read_bytes()
    times = np.zeros(len(data), int)

    class Counted(FileSource):
        def read(self, offset, length):
            times[offset : offset + length] += 1
            return super().read(offset, length)

    source = Counted(io.BytesIO(data))
    decode_box(source, EVERYWHERE)
    assert times.max() == 1
    assert source.bytes_read == times.sum() == len(data)


def flipped(file: bytes, at: int) -> bytes:
    return file[:at] + bytes([file[at] ^ 1]) + file[at + 1 :]


def test_a_file_that_is_cut_meanwhile(file):
    stream = io.BytesIO(file)
    source = FileSource(stream)
    stream.truncate(len(file) - 10)
    with pytest.raises(CodecError, match=r"file at byte \d+: it was cut"):
        decode_box(source, EVERYWHERE)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [((0, 0, 0), (1, 0, 1)), ((0, 2, 0), (1, 1, 1)), ((0, 0, np.nan), (1, 1, 1))],
)
def test_boxes_that_are_none(lower, upper):
    with pytest.raises(UsageError, match=r"^box: [xyz] from .* lower end first"):
        Box(lower, upper)


def test_a_box_has_three_ends_on_each_side():
    with pytest.raises(UsageError, match="box: give three lower and three upper ends"):
        Box((0.0, 0.0), (1.0, 1.0))
