"""Files of every released version decode for ever; those of this one are made bit for bit."""

from __future__ import annotations

import hashlib

import pytest

from clgs.codec.meta import LEVELS
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode, sort_anchors
from tests.codec.scenes import GOLDEN, assert_same, make_golden

HASHES = dict(line.split()[::-1] for line in (GOLDEN / "SHA256SUMS").read_text().splitlines())
MAKE = make_golden()
SCENES = MAKE.golden_scenes()


def test_the_files_are_those_of_the_list():
    for name, digest in HASHES.items():
        assert hashlib.sha256((GOLDEN / name).read_bytes()).hexdigest() == digest
    assert sorted(HASHES) == sorted(path.name for path in GOLDEN.glob("*.clgs"))
    assert {name.removesuffix(".clgs") for name in HASHES} == set(SCENES)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_files_are_made_and_read_bit_for_bit(name):
    """A change of the format before its release: make the files again, scripts/make_golden.py."""
    data = (GOLDEN / f"{name}.clgs").read_bytes()
    scene = SCENES[name]
    assert encode(scene, **MAKE.OPTIONS.get(name, {})) == data
    scene.anchors = sort_anchors(scene.anchors)
    assert_same(decode(data), scene)


def test_the_files_show_every_level_and_several_chunks():
    shown = [describe((GOLDEN / f"{name}.clgs").read_bytes()) for name in SCENES]
    assert {one["level"] for one in shown} == set(LEVELS)
    counts = {one["chunks"]["count"] for one in shown}
    assert counts >= {0, 1}
    assert max(counts) > 1
    assert {one["depth"] for one in shown} >= {0, 21}
    assert sum(2048 <= one["bytes"] <= 8192 for one in shown) >= 6
