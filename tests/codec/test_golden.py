"""Files of every released version decode for ever, and are still made bit for bit."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from clgs.codec.container import read_container
from clgs.codec.decode import decode
from clgs.codec.encode import encode, flatten, sort_anchors
from clgs.codec.meta import unpack_meta
from clgs.reference import octree, runlength
from tests.codec.scenes import GOLDEN, assert_same, golden_scenes

HASHES = dict(line.split()[::-1] for line in (GOLDEN / "SHA256SUMS").read_text().splitlines())


@pytest.mark.parametrize("name", sorted(HASHES))
def test_golden_file(name):
    data = (GOLDEN / name).read_bytes()
    assert hashlib.sha256(data).hexdigest() == HASHES[name]
    scene = golden_scenes()[name.removesuffix(".clgs")]
    scene.anchors = sort_anchors(scene.anchors)
    assert_same(decode(data), scene)
    assert encode(scene) == data


@pytest.mark.parametrize("name", sorted(HASHES))
def test_the_references_read_it(name):
    sections = read_container((GOLDEN / name).read_bytes())
    bytes_of = {tag: bytes(section.data) for tag, section in sections.items()}
    count = unpack_meta(bytes_of["META"]).anchors
    scene = decode((GOLDEN / name).read_bytes())
    a = scene.anchors
    if count:
        np.testing.assert_array_equal(octree.decode(bytes_of["ANCH"], count), a.position)
    for tag, value in (("OFFS", flatten(a.offset)), ("FEAT", a.feature), ("SCAL", a.scaling)):
        decoded = runlength.decode(bytes_of[tag], *value.shape)
        np.testing.assert_array_equal(decoded, value)


@pytest.mark.slow
def test_the_reference_reads_the_weights():
    data = (GOLDEN / "one.clgs").read_bytes()
    weights = decode(data).mlps.flat
    stream = bytes(read_container(data)["MLPS"].data)
    np.testing.assert_array_equal(runlength.decode_weights(stream, len(weights)), weights)


def test_no_file_is_missing():
    assert sorted(HASHES) == sorted(path.name for path in GOLDEN.glob("*.clgs"))
