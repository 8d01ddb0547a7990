"""Files of every version decode for ever, and those of the present one are made bit for bit."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from clgs.codec.container.meta import LEVELS
from clgs.codec.container.section_table import read_container, write_container
from clgs.codec.octree.position_coder import encode as encode_octree
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import flatten, sort_anchors
from clgs.codec.weights import encode as encode_weights
from clgs.errors import CodecError
from clgs.reference.codec import octree, planes, runlength
from tests.codec.scenes import GOLDEN, assert_same, make_golden

HASHES = dict(line.split()[::-1] for line in (GOLDEN / "SHA256SUMS").read_text().splitlines())


OLD = make_golden().version1_scenes()


def test_the_files_are_those_of_the_list():
    for name, digest in HASHES.items():
        assert hashlib.sha256((GOLDEN / name).read_bytes()).hexdigest() == digest
    assert sorted(HASHES) == sorted(path.name for path in GOLDEN.glob("*.clgs"))
    assert {name.removesuffix(".clgs") for name in HASHES} >= set(OLD)


@pytest.mark.parametrize("name", OLD)
def test_version_1_decodes(name):
    scene = OLD[name]
    scene.anchors = sort_anchors(scene.anchors)
    assert_same(decode((GOLDEN / f"{name}.clgs").read_bytes()), scene)


def test_version_1_has_no_modes_of_version_2():
    data = (GOLDEN / "surface.clgs").read_bytes()
    contents = {tag: bytes(s.data) for tag, s in read_container(data)[1].items()}
    scene = decode(data)
    position, rounded = (
        scene.anchors.position,
        np.rint(np.abs(scene.mlps.flat) * 64) / np.float32(64),
    )
    least = tuple(position.min(axis=0).tolist())
    for tag, section in (
        ("ANCH", encode_octree(position, least)),
        ("MLPS", encode_weights(rounded)),
    ):
        assert section[0] == 2
        with pytest.raises(CodecError, match=f"section {tag} at byte .*: mode 2, which version 1"):
            decode(write_container(contents | {tag: section}, major=1))


@pytest.mark.parametrize("name", OLD)
def test_the_references_read_version_1(name):
    data = (GOLDEN / f"{name}.clgs").read_bytes()
    bytes_of = {tag: bytes(s.data) for tag, s in read_container(data)[1].items()}
    a = decode(data).anchors
    if len(a):
        np.testing.assert_array_equal(octree.decode(bytes_of["ANCH"], len(a)), a.position)
    for tag, value in (("OFFS", flatten(a.offset)), ("FEAT", a.feature), ("SCAL", a.scaling)):
        decoded = runlength.decode(bytes_of[tag], *value.shape)
        np.testing.assert_array_equal(decoded, value)


@pytest.mark.slow
def test_the_reference_reads_the_weights():
    data = (GOLDEN / "one.clgs").read_bytes()
    weights = decode(data).mlps.flat
    stream = bytes(read_container(data)[1]["MLPS"].data)
    np.testing.assert_array_equal(planes.decode(stream, len(weights)), weights)


PRESENT = make_golden().golden_scenes()


@pytest.mark.parametrize("name", PRESENT)
def test_the_present_version_is_made_and_read_bit_for_bit(name):
    """A change of the format before its release: make the files again, scripts/make_golden.py."""
    data = (GOLDEN / f"{name}.clgs").read_bytes()
    assert make_golden().golden_file(name) == data
    scene = PRESENT[name]
    scene.anchors = sort_anchors(scene.anchors)
    assert_same(decode(data), scene)


def test_the_files_show_every_level_and_several_chunks():
    shown = [describe((GOLDEN / f"{name}.clgs").read_bytes()) for name in PRESENT]
    assert {one["level"] for one in shown} == set(LEVELS)
    counts = {one["chunks"]["count"] for one in shown}
    assert counts >= {0, 1}
    assert max(counts) > 1
    assert {one["depth"] for one in shown} >= {0, 21}
    assert sum(2048 <= one["bytes"] <= 8192 for one in shown) >= 6
