"""Damage that checksums do not show, memory that damage may ask for, and memory that runs out."""

from __future__ import annotations

import struct
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.scene_decoder import decode
from clgs.errors import CodecError
from tests.codec.container import damage
from tests.codec.container.allocations import MOST, calls
from tests.codec.container.mutations import ROOM, attempt, cases
from tests.codec.samples import sealed
from tests.codec.scenes import GOLDEN, ROOT


@pytest.mark.slow
def test_seeded_damage_with_right_checksums_is_an_error_or_decodes():
    outcomes = [
        attempt(case)[0]
        for _, case in zip(range(700), cases(np.random.default_rng(0)), strict=False)
    ]
    assert set(outcomes) == {"refused", "decoded"}  # both happen: the parsers are reached


@pytest.mark.slow
def test_much_seeded_damage_takes_little_time_and_memory():
    """Another process, so that memory held before does not hide what is taken."""
    command = [sys.executable, "-m", "tests.codec.container.mutations", "4000", "77"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("4000 inputs of seed 77")


def hostile_inputs() -> dict[str, tuple]:
    """Inputs that declare much and hold little, with right checksums, and bytes they may decode to.

    A header that declares more than the format allows is refused before any output.
    """
    rows = encode_attributes(np.zeros((10, 2), np.int32))[:-4]
    points = encode_positions(np.array([[1, 2, 3]]))[:-4]
    file = (GOLDEN / "chunks.clgs").read_bytes()
    meta = damage.contents(file)["META"]
    found = {}
    for count in (2**31, 2**32 - 1):
        number = struct.pack("<I", count)
        found[f"rows {count}"] = decode_attributes, sealed(rows[:4] + number + rows[8:])
        found[f"points {count}"] = decode_positions, sealed(points[:4] + number + points[8:])
        found[f"anchors {count}"] = decode, damage.rebuilt(file, META=number + meta[4:])
    for channels in (0, 257, 65535):
        wide = rows[:8] + struct.pack("<H", channels) + rows[10:]
        found[f"channels {channels}"] = decode_attributes, sealed(wide)
    return found


def peak_memory(decode, data):
    tracemalloc.start()
    try:
        decode(data, 1)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", hostile_inputs())
def test_declared_counts_take_no_memory(name):
    function, data = hostile_inputs()[name]

    def refused(data, threads):
        with pytest.raises(CodecError):
            function(data)

    assert peak_memory(refused, data) <= ROOM


@pytest.mark.slow
@pytest.mark.parametrize("level", ["fast", "default", "max", "paper"])
def test_memory_of_decoding_is_bounded_by_the_output(level):
    """Also of what is coded in next to no bytes: 200,000 equal rows."""
    rng = np.random.default_rng(1)
    for value in (np.zeros((200_000, 30), np.int32), rng.integers(-9, 9, (20_000, 50))):
        peak = peak_memory(decode_attributes, encode_attributes(value, level))
        assert peak <= ROOM + 2 * 4 * value.size


def test_memory_of_decoding_positions_is_bounded_by_the_output():
    cloud = np.argwhere(np.ones((70, 70, 70), bool))
    assert peak_memory(decode_positions, encode_positions(cloud)) <= ROOM + 2 * 12 * len(cloud)


@pytest.mark.parametrize("name", calls())
def test_every_allocation_that_fails_is_a_memory_error(name):
    """Another process: all of its threads are refused memory, and so would be those of pytest."""
    pytest.importorskip("_testcapi", reason="this Python has no _testcapi")
    command = [sys.executable, "-m", "tests.codec.container.allocations", name]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert 1 <= int(done.stdout) < MOST
