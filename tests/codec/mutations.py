"""Files and streams damaged in seeded ways, every checksum right, through the Python binding.

``python -m tests.codec.mutations [COUNT] [SEED]`` tries COUNT of them and prints what became of
them: a damaged input may decode, to anything; otherwise it is a CodecError.
"""

from __future__ import annotations

import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from clgs import _codec
from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.box import Box, decode_box
from clgs.codec.decode import decode, describe
from clgs.codec.encode import encode
from clgs.codec.meta import LEVELS
from clgs.codec.source import BytesSource
from clgs.errors import CodecError
from tests.codec import damage
from tests.codec.matrices import matrices
from tests.codec.scenes import GOLDEN, random_scene

Case = tuple[Callable[[bytes], object], bytes]
NUMBERS = (0, 1, 2, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)


def cases(rng: np.random.Generator) -> Iterator[Case]:
    """For ever: a function of the codec, and bytes for it."""
    files, streams = _files(), _streams()
    while True:
        if rng.random() < 0.5:
            reader = _READERS[rng.integers(len(_READERS))]
            yield reader, _damaged_file(rng, files)
        else:
            function, stream = streams[rng.integers(len(streams))]
            body = _changed(rng, stream[:-4])
            yield function, body + struct.pack("<I", _codec.crc32c(body))


def _in_box(data: bytes) -> object:
    return decode_box(BytesSource(data), Box((-1e9,) * 3, (0.0, 1e9, 1e9)), 1)


_READERS: list[Callable[[bytes], object]] = [lambda data: decode(data, 1), _in_box, describe]


@cache
def _files() -> list[bytes]:
    """Golden files, and small files of every level in several chunks."""
    scene = random_scene(np.random.default_rng(1), 60)
    small = [encode(scene, level, 16, 1) for level in LEVELS]
    return [path.read_bytes() for path in sorted(GOLDEN.glob("*.clgs"))] + small


@cache
def _streams() -> list[Case]:
    found: list[Case] = []
    for value in matrices().values():
        for level in LEVELS:
            data = encode_attributes(value[:60], level, 1)
            found.append((lambda data: decode_attributes(data, 1), data))
    rng = np.random.default_rng(2)
    for count, extent in ((1, 9), (40, 2**20), (300, 9), (60, 60)):
        cloud = np.unique(rng.integers(0, extent, (count, 3)), axis=0)
        found.append((lambda data: decode_positions(data, 1), encode_positions(cloud, 1)))
    return found


def _damaged_file(rng: np.random.Generator, files: list[bytes]) -> bytes:
    """A section changed, or exchanged for that of another file."""
    file = files[rng.integers(len(files))]
    sections = damage.contents(file)
    tag = str(rng.choice(list(sections)))
    if rng.random() < 0.1:
        other = damage.contents(files[rng.integers(len(files))])
        return damage.rebuilt(file, **{tag: other.get(tag, b"")})
    return damage.rebuilt(file, **{tag: _changed(rng, sections[tag])})


def _changed(rng: np.random.Generator, data: bytes) -> bytes:
    """One to four changes: bytes, numbers, parts left out, repeated or moved."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(out) + 1)) if rng.random() < 0.7 else int(rng.integers(17))
        length = int(rng.integers(1, 9))
        part = out[at : at + length]
        kind = rng.integers(6)
        if kind == 0:
            out[at : at + length] = rng.bytes(len(part))
        elif kind == 1:
            number = NUMBERS[rng.integers(len(NUMBERS))].to_bytes(4, "little")
            out[at : at + 4] = number[: len(out[at : at + 4])]
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[at:at] = part
        elif kind == 4:
            out[at:at] = rng.bytes(length)
        elif part:
            out[at] ^= 1 << int(rng.integers(8))
    return bytes(out)


def attempt(case: Case) -> str:
    """What became of a case: "decoded" or "refused"; any other exception passes through."""
    function, data = case
    try:
        function(data)
    except CodecError:
        return "refused"
    return "decoded"


def main() -> None:
    """Try many cases."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    outcomes: Counter[str] = Counter()
    slowest = 0.0
    for _, case in zip(range(count), cases(np.random.default_rng(seed)), strict=False):
        start = time.process_time()
        outcomes[attempt(case)] += 1
        slowest = max(slowest, time.process_time() - start)
    print(f"{count} inputs of seed {seed}: {dict(outcomes)}; slowest {slowest:.3f} s")


if __name__ == "__main__":
    main()
