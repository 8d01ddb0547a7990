"""`clgs bench codec`: size and speed of the codec and of general compressors, on one thread."""

from __future__ import annotations

import importlib
import lzma
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from clgs.cli.display import Display
from clgs.cli.tell import tell
from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.container.meta import LEVELS
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.errors import ClgsError
from clgs.lab.bench.codec_subjects import (
    ANCHORS,
    QUICK_ANCHORS,
    CodedData,
    Ints,
    file_subjects,
    seeded_subjects,
)
from clgs.lab.facts import show_table, write_figures
from clgs.scene.scene import QuantizedScene
from clgs.workflow.events import counter
from clgs.workflow.outputs import check_new

Note = Callable[[str], None]

SLOW = 1 << 22
"""Bytes above which general-purpose compressors run once: they take minutes."""


@dataclass(frozen=True)
class Coder:
    """A pair of functions; what ``decode`` returns is compared with what was coded."""

    name: str
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    once: bool = False


@dataclass(frozen=True)
class CoderFigures:
    """What one coder needs: bytes, and median seconds of ``repeats`` runs.

    ratio: of the bytes to those of the published coder, or else to those of the level ``paper``.
    """

    coder: str
    bytes: int
    encode_seconds: float
    decode_seconds: float
    repeats: int
    ratio: float | None


def run(
    data: Sequence[Path],
    anchors: int | None,
    quick: bool,
    seed: int,
    repeats: int,
    levels_only: bool,
    json: Path | None,
    overwrite: bool,
) -> int:
    """Measure, print and, if asked, write JSON; exit code 0."""
    if json:
        check_new(json, overwrite)
    anchors = anchors or (QUICK_ANCHORS if quick else ANCHORS)
    subjects = file_subjects(data) if data else seeded_subjects(anchors, seed)
    records, said = [], set[str]()

    def note(line: str) -> None:
        if line not in said:
            tell(f"clgs: {line}")
        said.add(line)

    with Display() as display:
        advance = counter("runs", 0, display)
        for subject in subjects:
            figures = bench_subject(subject, repeats, levels_only, note, advance)
            records.append(
                {
                    "name": subject.name,
                    "kind": subject.kind,
                    "symbols": subject.symbols,
                    "baseline": subject.baseline,
                    "coders": [asdict(one) for one in figures],
                }
            )
    head = ("data and coder", "bytes", "ratio", "bits per number", "encode s", "decode s")
    show_table("one thread", head, (row for one in records for row in _rows(one)))
    write_figures(json, {"subjects": records})
    return 0


def _rows(record: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """A line for what was coded, one for each coder, and an empty one."""
    baseline = record["baseline"]
    yield (record["name"], *((f"{baseline:,}", "published") if baseline else ()))
    for one in record["coders"]:
        yield (
            f"  {one['coder']}",
            f"{one['bytes']:,}",
            "" if one["ratio"] is None else f"{one['ratio']:.3f}",
            f"{8 * one['bytes'] / max(record['symbols'], 1):.3f}",
            f"{one['encode_seconds']:.3f}",
            f"{one['decode_seconds']:.3f}",
        )
    yield ()


def bench_subject(
    subject: CodedData, repeats: int, levels_only: bool, note: Note, advance: Callable[[], None]
) -> list[CoderFigures]:
    """Time every coder of the subject's kind; runs of all coders alternate.

    Raises:
        ClgsError: a coder gives back other numbers.
    """
    coders = own_coders(subject)
    if not (levels_only or isinstance(subject.content, QuantizedScene)):
        coders += general_coders(subject.content, note)
    runs: dict[str, list[tuple[int, float, float]]] = {coder.name: [] for coder in coders}
    for repeat in range(repeats):
        for coder in coders:
            if repeat and coder.once:
                continue
            start = time.perf_counter()
            data = coder.encode(subject.content)
            middle = time.perf_counter()
            decoded = coder.decode(data)
            end = time.perf_counter()
            content = subject.content
            pairs: list[tuple[Any, Any]] = [(decoded, content)]
            if isinstance(content, QuantizedScene):
                items = content.anchors.items()
                pairs = [(getattr(decoded.anchors, name), array) for name, array in items]
            if not all(np.array_equal(*pair) for pair in pairs):
                problem = f"{coder.name} gives back other numbers than those of {subject.name}"
                raise ClgsError(problem)
            runs[coder.name].append((len(data), middle - start, end - middle))
            advance()
    base = subject.baseline or (runs["paper"][0][0] if "paper" in runs else None)
    found = []
    for name, own in runs.items():
        (size, *_), encoding, decoding = zip(*own, strict=True)
        ratio = size / base if base else None
        found.append(CoderFigures(name, size, median(encoding), median(decoding), len(own), ratio))
    return found


def own_coders(subject: CodedData) -> list[Coder]:
    """Our own: one per level; positions have one only."""
    if subject.kind == "positions":
        one_thread = partial(encode_positions, threads=1), partial(decode_positions, threads=1)
        return [Coder("octree", *one_thread)]
    write: Callable[..., bytes] = encode_attributes
    read: Callable[..., Any] = decode_attributes
    if subject.kind == "scene":
        write, read = encode, decode
    return [
        Coder(level, partial(write, level=level, threads=1), partial(read, threads=1))
        for level in LEVELS
    ]


def general_coders(content: Ints, note: Note) -> list[Coder]:
    """General-purpose compressors that are installed, on the narrowest integers, row by row."""
    low = content.min(axis=0, initial=0).astype(np.int64)
    span = int((content - low).max(initial=0))
    dtype = np.dtype(next(d for d in (np.uint8, np.uint16, np.uint32) if span <= np.iinfo(d).max))

    def coder(name: str, pack: Callable[[bytes], bytes], unpack: Callable[[bytes], bytes]) -> Coder:
        def widen(data: bytes) -> Ints:
            rows = np.frombuffer(unpack(data), dtype).reshape(content.shape) + low
            return np.asarray(rows, np.int32)

        slow = content.size * dtype.itemsize > SLOW
        return Coder(name, lambda rows: pack((rows - low).astype(dtype).tobytes()), widen, slow)

    found = [coder("xz -9", partial(lzma.compress, preset=9), lzma.decompress)]
    if zstd := _optional("zstandard", note):
        pack, unpack = zstd.ZstdCompressor(level=19).compress, zstd.ZstdDecompressor().decompress
        found.insert(0, coder("zstd -19", pack, unpack))
    if brotli := _optional("brotli", note):
        found.append(coder("brotli 11", partial(brotli.compress, quality=11), brotli.decompress))
    return found


def _optional(name: str, note: Note) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        note(f'{name} is not installed and is left out: pip install "clgs[bench]"')
        return None
