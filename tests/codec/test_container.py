"""Whole files: round trips, and one clear CodecError for whatever is done to one."""

from __future__ import annotations

import struct
import time
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec import container
from clgs.codec.decode import decode, describe
from clgs.codec.encode import encode, sort_anchors
from clgs.codec.meta import unpack_meta
from clgs.errors import CodecError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform
from tests.codec.scenes import GOLDEN, assert_same, random_scene

SMALL = (GOLDEN / "surface.clgs").read_bytes()


@pytest.fixture
def scene(rng):
    return random_scene(rng)


def contents(data: bytes) -> dict[str, bytes]:
    return {tag: bytes(s.data) for tag, s in container.read_container(data).items()}


def rebuilt(**changed: bytes) -> bytes:
    """The small file with sections replaced and every checksum made right."""
    return container.write_container({**contents(SMALL), **changed})


def test_a_scene_survives_and_comes_back_in_morton_order(scene):
    data = encode(scene)
    decoded = decode(data)
    assert_same(decoded, replace_anchors(scene, sort_anchors(scene.anchors)))
    assert encode(decoded) == data
    order = np.random.default_rng(0).permutation(len(scene.anchors))
    a = scene.anchors
    shuffled = QuantizedAnchors(
        a.position[order], a.offset[order], a.feature[order], a.scaling[order]
    )
    assert encode(replace_anchors(scene, shuffled)) == data


def replace_anchors(scene: QuantizedScene, anchors: QuantizedAnchors) -> QuantizedScene:
    return replace(scene, anchors=anchors)


def test_settings_survive_to_the_last_bit(scene):
    third = 1 / 3
    scene.scales = QuantizationScales(200 * third, third, 2.0**-64, 2.0**60)
    scene.transform = SceneTransform((-third, 1e300, -0.0), 4.4 * third)
    scene.settings = RenderSettings((0.0, third, 1.0), third, third / 9, 1.0, 0.0, third)
    decoded = decode(encode(scene))
    assert_same(decoded, replace_anchors(scene, sort_anchors(scene.anchors)))
    assert all(np.isfinite(x).all() for x in vars(decoded.dequantize().anchors).values())


def test_every_single_bit_flip_is_a_codec_error():
    start = time.perf_counter()
    for at in range(len(SMALL)):
        for bit in range(8):
            damaged = bytearray(SMALL)
            damaged[at] ^= 1 << bit
            with pytest.raises(CodecError, match=r" at byte \d+: "):
                decode(bytes(damaged))
    assert time.perf_counter() - start < 1e-3 * 8 * len(SMALL)


def test_every_truncation_and_trailing_bytes_are_codec_errors():
    for size in range(len(SMALL)):
        with pytest.raises(CodecError, match=r"; \w+"):
            decode(SMALL[:size])
    for tail in range(1, 17):
        with pytest.raises(CodecError, match="follow the last section"):
            decode(SMALL + b"\0" * tail)


def test_one_byte_more_or_less_in_a_section_is_refused_even_with_right_checksums():
    sections = contents(SMALL)
    for tag in container.SECTIONS:
        for changed in (sections[tag][:-1], sections[tag] + b"\0", b""):
            with pytest.raises(CodecError, match="section"):
                decode(rebuilt(**{tag: changed}))


def test_random_damage_with_right_checksums_is_refused(rng):
    sections = contents(SMALL)
    for _ in range(150):
        tag = str(rng.choice(["META", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS"]))
        content = bytearray(sections[tag])
        for _ in range(rng.integers(1, 4)):
            content[rng.integers(len(content))] ^= rng.integers(1, 256)
        if bytes(content) != sections[tag]:
            with pytest.raises(CodecError, match="section"):
                accept_other_settings(rebuilt(**{tag: bytes(content)}))


def accept_other_settings(data: bytes) -> None:
    """Decode; a change that touches only settings of META is another valid file, not damage."""
    decode(data)
    meta, original = (unpack_meta(contents(file)["META"]) for file in (data, SMALL))
    assert meta.content_hash == original.content_hash
    raise CodecError("section META: other settings")


def test_missing_swapped_repeated_and_unknown_sections():
    sections = contents(SMALL)
    for tag in container.SECTIONS:
        rest = {k: v for k, v in sections.items() if k != tag}
        with pytest.raises(CodecError, match=f"section {tag}: missing"):
            decode(container.write_container(rest))
    swapped = {k: sections[k] for k in ("META", "ANCH", "FEAT", "OFFS", "SCAL", "MLPS")}
    with pytest.raises(CodecError, match="order is META ANCH FEAT OFFS"):
        decode(container.write_container(swapped))
    with pytest.raises(CodecError, match=r"section WHAT at byte .*: unknown; update clgs"):
        decode(container.write_container({**sections, "WHAT": b"x"}))
    with pytest.raises(CodecError, match="'OFFS' is repeated"):
        decode(patched(16 + 3 * 32, b"OFFS"))


def patched(at: int, new: bytes) -> bytes:
    """The small file with header bytes replaced and the header's checksum made right."""
    data = bytearray(SMALL)
    data[at : at + len(new)] = new
    end = 16 + 6 * 32
    data[end : end + 4] = struct.pack("<I", container._codec.crc32c(bytes(data[:end])))
    return bytes(data)


def test_unknown_optional_sections_are_skipped():
    file = container.write_container({**contents(SMALL), "NOTE": b"hello"})
    data = bytearray(file)
    entry = 16 + 6 * 32
    assert data[entry : entry + 4] == b"NOTE"
    data[entry + 4] = 0
    end = entry + 32
    data[end : end + 4] = struct.pack("<I", container._codec.crc32c(bytes(data[:end])))
    assert_same(decode(bytes(data)), decode(SMALL))


@pytest.mark.parametrize("field", ["offset", "length"])
@pytest.mark.parametrize("value", [0, 1, 2**40, 2**63, 2**64 - 1])
def test_hostile_offsets_and_lengths(field, value):
    at = 16 + 2 * 32 + (8 if field == "offset" else 16)
    with pytest.raises(CodecError, match=r"do not fit|follow"):
        decode(patched(at, struct.pack("<Q", value)))


@pytest.mark.parametrize("count", [65, 2**31, 2**32 - 1])
def test_hostile_section_counts(count):
    with pytest.raises(CodecError, match="at most 64"):
        decode(patched(12, struct.pack("<I", count)))


def test_versions():
    with pytest.raises(CodecError, match="version 2, known is 1; update clgs"):
        decode(patched(8, struct.pack("<H", 2)))
    assert_same(decode(patched(10, struct.pack("<H", 7))), decode(SMALL))


def test_what_is_no_clgs_file():
    for data in (b"PK\3\4" + bytes(50), b"ply\n", bytes(1000)):
        with pytest.raises(CodecError, match=r"not a \.clgs file; make one"):
            decode(data)
    with pytest.raises(CodecError, match="empty"):
        decode(b"")
    with pytest.raises(CodecError, match="line ends were changed"):
        decode(SMALL.replace(b"\r\n", b"\n"))
    assert CodecError("").exit_code == 3


def test_declared_anchors_are_bounded_by_the_bytes_that_follow():
    for count in (0, 1, 35, 37, 10**6, 2**32 - 1):
        meta = struct.pack("<I", count) + contents(SMALL)["META"][4:]
        start = time.perf_counter()
        with pytest.raises(CodecError, match="section"):
            decode(rebuilt(META=meta))
        assert time.perf_counter() - start < 1


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("at", range(16, 144, 8))
def test_header_numbers_that_are_not_finite_are_refused(at, value):
    meta = bytearray(contents(SMALL)["META"])
    meta[at : at + 8] = struct.pack("<d", value)
    with pytest.raises(CodecError, match=r"section META at byte 212: .* is "):
        decode(rebuilt(META=bytes(meta)))


@pytest.mark.parametrize(
    ("at", "value"),
    [
        *[(16, 0.0), (24, -1.0), (32, 5e-324), (40, -0.0), (72, 0.0), (80, 1.5), (104, 0.0)],
        *[(104, 1e300), (112, 0.0), (120, 1.01), (128, 1.0), (136, -0.1), (136, 1e300)],
    ],
)
def test_header_numbers_out_of_range_are_refused(at, value):
    meta = bytearray(contents(SMALL)["META"])
    meta[at : at + 8] = struct.pack("<d", value)
    with pytest.raises(CodecError, match="section META"):
        decode(rebuilt(META=bytes(meta)))


def test_other_network_shapes_are_refused():
    for at in (4, 6, 8, 10, 12):
        meta = bytearray(contents(SMALL)["META"])
        meta[at] ^= 1
        with pytest.raises(CodecError, match="shape"):
            decode(rebuilt(META=bytes(meta)))


def test_weights_that_are_not_finite_are_refused_on_both_sides(scene):
    for value in (np.nan, np.inf):
        weights = scene.mlps.flat.copy()
        weights[7] = value
        with pytest.raises(CodecError, match="mlps: weight 7 is"):
            encode(replace(scene, mlps=Mlps(weights)))
        raw = b"\0" + weights.astype("<f4").tobytes()
        with pytest.raises(CodecError, match=r"section MLPS .* not finite"):
            decode(rebuilt(MLPS=raw))


def test_the_encoder_refuses_what_no_file_may_hold(scene):
    with pytest.raises(CodecError, match=r"header: Q of offset is nan"):
        encode(replace(scene, scales=QuantizationScales(offset=float("nan"))))
    with pytest.raises(CodecError, match="header: background is 2"):
        encode(replace(scene, settings=RenderSettings(background=(0.0, 2.0, 0.0))))
    scene.anchors.position[1] = scene.anchors.position[0]
    with pytest.raises(CodecError, match="anchors 0 and 1 share cell"):
        encode(scene)


def test_describe_is_plain_and_adds_up(scene):
    data = encode(scene)
    info = describe(data)
    assert info["bytes"] == len(data) == sum(info["sections"].values())
    assert info["anchors"] == len(scene.anchors)
    assert info["version"] == "1.0"
    assert info["scales"] == {"position": 200.0, "offset": 1.0, "feature": 1.0, "scaling": 8.0}
    assert list(info["sections"]) == ["container", *container.SECTIONS]
    with pytest.raises(CodecError):
        describe(data[:-1])
