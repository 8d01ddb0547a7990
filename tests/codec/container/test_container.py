"""Whole files: round trips, and one clear CodecError for all that is done to one."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from clgs.codec.meta import unpack_meta
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode, sort_anchors
from clgs.codec.sections import SCENE, write_container
from clgs.errors import CodecError, UsageError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform
from tests.codec.container.damage import ENTRY, HEAD, contents, patched, rebuilt
from tests.codec.scenes import GOLDEN, assert_same, random_scene

FILE = (GOLDEN / "chunks.clgs").read_bytes()


@pytest.fixture
def scene(rng):
    return random_scene(rng)


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


TABLE = HEAD + len(SCENE) * ENTRY + 4


def test_flipped_bits_are_codec_errors():
    """Every bit of the header and the section table, then one of every byte."""
    refuse_flips(FILE, (*range(8 * TABLE), *range(8 * TABLE, 8 * len(FILE), 9)))


def test_truncations_and_trailing_bytes_are_codec_errors():
    refuse_cuts(FILE, (*range(TABLE), *range(TABLE, len(FILE), 5), len(FILE) - 1))


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.clgs")), ids=lambda path: path.stem)
def test_flips_and_cuts_of_every_golden_file(path):
    file = path.read_bytes()
    refuse_flips(file, range(0, 8 * len(file), 3))  # every bit of a byte in turn
    layers = describe(file).get("layers")
    # A cut file in layers is a scene from the first layer's end on: test_layers.
    refuse_cuts(file, range(layers[0]["end"] if layers else len(file)))


def refuse_flips(file: bytes, bits: Iterable[int]) -> None:
    for bit in bits:
        damaged = bytearray(file)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(CodecError, match=r" at byte \d+: "):
            decode(bytes(damaged))


def refuse_cuts(file: bytes, sizes: Iterable[int]) -> None:
    for size in sizes:
        with pytest.raises(CodecError, match=r"; \w+"):
            decode(file[:size])
    for tail in range(1, 17):
        with pytest.raises(CodecError, match="follow the last section"):
            decode(file + b"\0" * tail)


def test_one_byte_more_or_less_in_a_section_is_refused_even_with_right_checksums():
    for tag, section in contents(FILE).items():
        for changed in (section[:-1], section + b"\0", b""):
            with pytest.raises(CodecError, match="section"):
                decode(rebuilt(FILE, **{tag: changed}))


@pytest.mark.slow
def test_random_damage_with_right_checksums_is_refused(rng):
    sections = contents(FILE)
    for _ in range(60):
        tag = str(rng.choice(list(sections)))
        content = bytearray(sections[tag])
        for _ in range(rng.integers(1, 4)):
            content[rng.integers(len(content))] ^= rng.integers(1, 256)
        if bytes(content) != sections[tag]:
            with pytest.raises(CodecError, match="section"):
                accept_other_settings(rebuilt(FILE, **{tag: bytes(content)}), FILE)


def accept_other_settings(data: bytes, file: bytes) -> None:
    """Decode; a change that touches only settings of META is another valid file, not damage."""
    decode(data)
    meta, original = (unpack_meta(contents(f)["META"]) for f in (data, file))
    assert meta.content_hash == original.content_hash
    raise CodecError("section META: other settings")


def test_missing_swapped_repeated_and_unknown_sections():
    sections = contents(FILE)
    for tag in sections:
        rest = {k: v for k, v in sections.items() if k != tag}
        with pytest.raises(CodecError, match=f"section {tag} is missing"):
            decode(write_container(rest))
    swapped = {**sections, "OFFS": b"", "FEAT": b""}
    tags = ["FEAT" if k == "OFFS" else "OFFS" if k == "FEAT" else k for k in swapped]
    with pytest.raises(CodecError, match=r"order is META .*ANCH FEAT OFFS"):
        decode(write_container({tag: sections[tag] for tag in tags}))
    with pytest.raises(CodecError, match=r"section WHAT at byte .*: unknown; update clgs"):
        decode(write_container({**sections, "WHAT": b"x"}))
    with pytest.raises(CodecError, match="'OFFS' is repeated"):
        decode(patched(FILE, HEAD + (len(sections) - 3) * ENTRY, b"OFFS"))


def test_unknown_optional_sections_are_skipped_but_checked():
    sections = contents(FILE)
    longer = write_container({**sections, "NOTE": b"hello"})
    entry = HEAD + len(sections) * ENTRY
    assert longer[entry : entry + 4] == b"NOTE"
    longer = patched(longer, entry + 4, b"\0")
    assert_same(decode(longer), decode(FILE))
    with pytest.raises(CodecError, match=r"section NOTE at byte .*checksum differs"):
        decode(longer[:-1] + b"0")


@pytest.mark.parametrize("tag", [b"A1BC", b"NOT ", b"\xc4\xd6\xdc\xdf", bytes(4)])
def test_tags_are_letters(tag):
    longer = write_container({**contents(FILE), "NOTE": b"hello"})
    entry = HEAD + len(contents(FILE)) * ENTRY
    with pytest.raises(CodecError, match="is repeated or malformed"):
        decode(patched(longer, entry, tag + bytes(4)))


@pytest.mark.parametrize("flags", [0, 2, 3, 2**31])
def test_required_sections_are_marked_so(flags):
    for entry in range(HEAD, HEAD + len(contents(FILE)) * ENTRY, ENTRY):
        with pytest.raises(CodecError, match="is repeated or malformed"):
            decode(patched(FILE, entry + 4, struct.pack("<I", flags)))


@pytest.mark.parametrize("field", ["offset", "length"])
@pytest.mark.parametrize("value", [0, 1, 2**40, 2**63, 2**64 - 1])
def test_hostile_offsets_and_lengths(field, value):
    at = HEAD + 2 * ENTRY + (8 if field == "offset" else 16)
    with pytest.raises(CodecError, match=r"do not fit|follow"):
        decode(patched(FILE, at, struct.pack("<Q", value)))


@pytest.mark.parametrize("count", [65, 2**31, 2**32 - 1])
def test_hostile_section_counts(count):
    with pytest.raises(CodecError, match="at most 64"):
        decode(FILE[:12] + struct.pack("<I", count) + FILE[16:])


def test_versions():
    for other in (0, 2, 3, 2**16 - 1):
        said = (
            rf"^header at byte 8: version {other}\.0, this clgs reads 1\.x; update clgs, or encode"
        )
        with pytest.raises(CodecError, match=said):
            decode(patched(FILE, 8, struct.pack("<H", other)))
    newer = patched(FILE, 10, struct.pack("<H", 7))
    assert_same(decode(newer), decode(FILE))
    assert (describe(FILE)["version"], describe(newer)["version"]) == ("1.0", "1.7")


def test_what_is_no_clgs_file():
    for data in (b"PK\3\4" + bytes(50), b"ply\n", bytes(1000)):
        with pytest.raises(CodecError, match=r"not a \.clgs file; make one"):
            decode(data)
    with pytest.raises(CodecError, match=r"`clgs pack`; it begins as a \.ply file does$"):
        decode(b"ply\n")
    with pytest.raises(CodecError, match="empty"):
        decode(b"")
    with pytest.raises(CodecError, match="line ends were changed"):
        decode(FILE.replace(b"\r\n", b"\n"))
    assert CodecError("").exit_code == 3


def test_declared_anchors_are_bounded_by_the_bytes_that_follow():
    for count in (0, 1, 35, 37, 10**6, 2**32 - 1):
        meta = struct.pack("<I", count) + contents(FILE)["META"][4:]
        with pytest.raises(CodecError, match="section"):
            decode(rebuilt(FILE, META=meta))


def with_number(at: int, value: float) -> bytes:
    """The file with one f64 of META replaced."""
    meta = bytearray(contents(FILE)["META"])
    meta[at : at + 8] = struct.pack("<d", value)
    return rebuilt(FILE, META=bytes(meta))


@pytest.mark.parametrize("value", [float("nan"), -float("inf")])
@pytest.mark.parametrize("at", range(16, 144, 8))
def test_header_numbers_that_are_not_finite_are_refused(at, value):
    with pytest.raises(CodecError, match=r"section META at byte 2[14]\d: .* is "):
        decode(with_number(at, value))


@pytest.mark.parametrize(
    ("at", "value"),
    [
        *[(16, 0.0), (24, -1.0), (32, 5e-324), (40, -0.0), (72, 0.0), (80, 1.5), (104, 0.0)],
        *[(104, 1e300), (112, 0.0), (120, 1.01), (128, 1.0), (136, -0.1), (136, 1e300)],
    ],
)
def test_header_numbers_out_of_range_are_refused(at, value):
    with pytest.raises(CodecError, match="section META"):
        decode(with_number(at, value))


def test_other_network_shapes_are_refused():
    for at in (4, 6, 8, 10, 12):
        meta = bytearray(contents(FILE)["META"])
        meta[at] ^= 1
        with pytest.raises(CodecError, match="shape"):
            decode(rebuilt(FILE, META=bytes(meta)))


def test_weights_that_are_not_finite_are_refused_on_both_sides(scene):
    for value in (np.nan, np.inf):
        weights = scene.mlps.flat.copy()
        weights[7] = value
        with pytest.raises(CodecError, match="mlps: weight 7 is"):
            encode(replace(scene, mlps=Mlps(weights)))
        raw = b"\0" + weights.astype("<f4").tobytes()
        with pytest.raises(CodecError, match=r"section MLPS .* not finite"):
            decode(rebuilt(FILE, MLPS=raw))


def test_the_encoder_refuses_what_no_file_may_hold(scene):
    with pytest.raises(CodecError, match=r"header: Q of offset is nan"):
        encode(replace(scene, scales=QuantizationScales(offset=float("nan"))))
    with pytest.raises(CodecError, match="header: background is 2"):
        encode(replace(scene, settings=RenderSettings(background=(0.0, 2.0, 0.0))))
    scene.anchors.position[1] = scene.anchors.position[0]
    with pytest.raises(CodecError, match=r"rows 0 and 1 share cell .* 1 rows repeat others"):
        encode(scene)


def test_weights_are_the_same_as_integers_and_as_floats(scene, rng):
    scene.mlps.flat[:] = rng.integers(-99, 99, len(scene.mlps.flat)) / 128
    packed, floats = encode(scene), encode(scene, mlp="float32")
    assert contents(packed)["MLPS"][0] == 2
    assert contents(floats)["MLPS"][0] == 1
    assert_same(decode(packed), decode(floats))


def test_options_that_make_no_sense_are_refused(scene):
    for options in (
        {"level": "best"},
        {"chunk": 15},
        {"chunk": 2**20 + 1},
        {"threads": 0},
        {"mlp": "x"},
    ):
        with pytest.raises(UsageError, match=f"^{next(iter(options))}: "):
            encode(scene, **options)


def test_describe_is_plain_and_adds_up():
    info = describe(FILE)
    assert json.loads(json.dumps(info))["anchors"] == len(decode(FILE).anchors)
    assert info["bytes"] == len(FILE) == sum(info["sections"].values())
    assert info["scales"] == {"position": 200.0, "offset": 1.0, "feature": 1.0, "scaling": 8.0}
    assert list(info["sections"]) == ["container", *SCENE]
    assert info["level"] == "default"
    assert info["chunks"] == {"anchors": 64, "count": 4}
    assert (info["origin"], info["depth"]) == ((0, 0, -3), 5)
    with pytest.raises(CodecError):
        describe(FILE[:-1])
