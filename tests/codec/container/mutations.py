"""Files and streams damaged in seeded ways, every checksum right, through the Python binding.

``python -m tests.codec.container.mutations [COUNT] [SEED]`` tries COUNT of them and prints
what became of them: a damaged input may decode, to anything; otherwise it is a CodecError. One case
in eight is an array that must come back from its stream. A case that takes more than a second, or
more than 64 MiB in addition to twice its output, is a fault and ends the run.
"""

from __future__ import annotations

import resource
import struct
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial

import numpy as np

from clgs import _codec
from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.meta import LEVELS
from clgs.codec.scene_decoder import decode, decode_box, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import CHNK, SATR, SMUL, SPOS, BytesSource
from clgs.codec.splat_packing import QuantizedSplats, pack, unpack
from clgs.errors import CodecError
from clgs.scene.region import Box
from tests.codec import binding_cases
from tests.codec.container import damage
from tests.codec.samples import matrices
from tests.codec.scenes import GOLDEN, random_scene

Case = tuple[Callable[[bytes], object], bytes]
ROOM = 64 << 20
"""Bytes that a decoder may take in addition to twice its output."""

MOST_SECONDS = 1.0
NUMBERS = (0, 1, 2, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)


def cases(rng: np.random.Generator) -> Iterator[Case]:
    """Functions of the codec with bytes for them, without an end."""
    files, streams, calls = _files(), _streams(), binding_cases.streams()
    while True:
        kind = rng.random()
        if kind < 0.125:
            number = rng.bytes(8)
            yield (_points, number) if kind < 0.04 else (_rows, number)
        elif kind < 0.25:
            function, stream = calls[rng.integers(len(calls))]
            yield function, changed(rng, stream)
        elif kind < 0.7:
            file = damaged_file(rng, files)
            of_splats = file[damage.HEAD : damage.HEAD + 4] == b"SPLT"
            scene = _READERS[rng.integers(len(_READERS))]
            yield _unpack if of_splats == (rng.random() < 0.95) else scene, file
        else:
            function, stream = streams[rng.integers(len(streams))]
            body = changed(rng, stream[:-4])
            yield function, body + struct.pack("<I", _codec.crc32c(body))


def _rows(number: bytes) -> None:
    binding_cases.there_and_back(np.random.default_rng(list(number)))


def _points(number: bytes) -> None:
    binding_cases.points_there_and_back(np.random.default_rng(list(number)))


def _in_box(data: bytes) -> object:
    return decode_box(BytesSource(data), Box((-1e9,) * 3, (0.0, 1e9, 1e9)), 1)


_READERS: list[Callable[[bytes], object]] = [partial(decode, threads=1), _in_box, describe]
_unpack: Callable[[bytes], object] = partial(unpack, threads=1)


@cache
def _files() -> list[bytes]:
    """Golden files, and small files of every level in several chunks, of scenes and of splats."""
    rng = np.random.default_rng(1)
    scene = random_scene(rng, 60)
    small = [encode(scene, level, 16, 1) for level in LEVELS]
    splats = QuantizedSplats([*"xyzab"], [0.5] * 5, rng.integers(-3, 4, (90, 5)).astype(np.int32))
    small += [encode(scene, level, 16, 1, layers=3) for level in LEVELS]
    small += [encode(scene, level, 16, 1, layers=2, details=True) for level in LEVELS]
    small += [pack(splats, level, 1) for level in LEVELS] * 2
    return [path.read_bytes() for path in sorted(GOLDEN.glob("*.clgs"))] + small


@cache
def _streams() -> list[Case]:
    found: list[Case] = []
    for value in matrices().values():
        for level in LEVELS:
            data = encode_attributes(value[:60], level, 1)
            found.append((lambda data: decode_attributes(data, 1), data))
    rng = np.random.default_rng(2)
    for count, extent, factor in ((1, 9, 1), (40, 2**20, 1), (300, 9, 1), (60, 60, 1), (90, 60, 6)):
        cloud = np.unique(rng.integers(0, extent, (count, 3)), axis=0) * factor
        found.append((lambda data: decode_positions(data, 1), encode_positions(cloud, 1)))
    return found


def damaged_file(rng: np.random.Generator, files: list[bytes]) -> bytes:
    """A section changed, or exchanged for that of another file, or the section table changed."""
    file = files[rng.integers(len(files))]
    if rng.random() < 0.1:
        table = damage.HEAD + damage.ENTRY * int.from_bytes(file[12:16], "little")
        return damage.patched(file, 0, changed(rng, file[:table])[:table])
    sections = damage.contents(file)
    tag = str(rng.choice(list(sections)))
    if rng.random() < 0.1:
        other = damage.contents(files[rng.integers(len(files))])
        return damage.rebuilt(file, **{tag: other.get(tag, b"")})
    section = changed(rng, sections[tag])
    if tag == CHNK:
        section = damage.sealed_directory(section)
    if tag in (SPOS, SMUL, SATR):
        section = section[:-4] + struct.pack("<I", _codec.crc32c(section[:-4]))
    return damage.rebuilt(file, **{tag: section})


def changed(rng: np.random.Generator, data: bytes) -> bytes:
    """One to four changes: bytes, numbers, bits, parts left out, repeated or put in.

    Mostly all bytes stay where they are and the head as it is: what follows is reached.
    """
    out = bytearray(data)
    deep = rng.random() < 0.7
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(len(out) + 1)) if rng.random() < 0.7 else int(rng.integers(17))
        if deep:
            at = int(rng.integers(min(20, len(out)), len(out) + 1))
        length = int(rng.integers(1, 9))
        part = out[at : at + length]
        kind = int(rng.choice((0, 1, 5))) if deep else int(rng.integers(6))
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


def attempt(case: Case) -> tuple[str, int]:
    """What became of a case, "decoded" or "refused", and bytes of output; others pass through."""
    function, data = case
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # files that are cut in a layer
            output = function(data)
    except CodecError:
        return "refused", 0
    return "decoded", size_of(output)


def size_of(output: object) -> int:
    """Bytes of the arrays in what a function gave back."""
    if isinstance(output, np.ndarray):
        return output.nbytes
    parts = getattr(output, "__dict__", {}).values()
    return sum(map(size_of, parts))


def memory() -> int:
    """The most bytes that this process has held so far."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Try many cases."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    rng = np.random.default_rng(seed)
    outcomes = Counter(attempt(case)[0] for _, case in zip(range(500), cases(rng), strict=False))
    begin, slowest, at = memory(), 0.0, 0  # the library is loaded
    for at, case in zip(range(count), cases(rng), strict=False):
        start = time.process_time()
        outcome, size = attempt(case)
        taken = time.process_time() - start
        outcomes[outcome] += 1
        slowest = max(slowest, taken)
        if taken > MOST_SECONDS or memory() - begin > ROOM + 2 * size:
            sys.exit(
                f"case {at} of seed {seed}, {outcome}: {taken:.3f} s, {memory() - begin} bytes"
            )
    more = (memory() - begin) >> 20
    print(f"{at + 1} inputs of seed {seed}: {dict(outcomes)}; slowest {slowest:.3f} s, {more} MiB")


if __name__ == "__main__":
    main()
