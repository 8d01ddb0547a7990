"""`clgs bench codec`: size and speed of the codec and of general compressors, on one thread."""

from __future__ import annotations

import argparse
import importlib
import lzma
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from clgs.cli.display import Display
from clgs.cli.tell import tell
from clgs.codec import decode_attributes, decode_positions, encode_attributes, encode_positions
from clgs.codec.container.meta import LEVELS
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.errors import ClgsError
from clgs.files import check_target, write_json
from clgs.lab.bench.codec_subjects import (
    ANCHORS,
    QUICK_ANCHORS,
    CodedData,
    Ints,
    file_subjects,
    seeded_subjects,
)
from clgs.lab.facts import command_line
from clgs.machine import host_facts
from clgs.scene.scene import QuantizedScene
from clgs.workflow.events import counter

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
    """What one coder needs: bytes, and median seconds of ``repeats`` runs."""

    coder: str
    bytes: int
    encode_seconds: float
    decode_seconds: float
    repeats: int


def run(args: argparse.Namespace) -> int:
    """Measure, print and, if asked, write JSON; exit code 0."""
    if args.json:
        check_target(args.json)
    anchors = args.anchors or (QUICK_ANCHORS if args.quick else ANCHORS)
    subjects = file_subjects(args.data) if args.data else seeded_subjects(anchors, args.seed)
    table = Table(title="one thread", box=box.SIMPLE, pad_edge=False)
    for column in ("data", "coder"):
        table.add_column(column, no_wrap=True)
    widths = {"bytes": 11, "ratio": 6, "bits": 7, "encode s": 8, "decode s": 8}
    for column, width in widths.items():
        table.add_column(column, justify="right", no_wrap=True, min_width=width)
    records, said = [], set[str]()

    def note(line: str) -> None:
        if line not in said:
            tell(f"clgs: {line}")
        said.add(line)

    with Display() as display:
        advance = counter("runs", 0, display)
        for subject in subjects:
            figures = bench_subject(subject, args.repeats, args.levels_only, note, advance)
            add_rows(table, subject, figures)
            shares = zip(figures, ratios(subject, figures), strict=True)
            records.append(
                {
                    "name": subject.name,
                    "kind": subject.kind,
                    "symbols": subject.symbols,
                    "baseline": subject.baseline,
                    "coders": [{**asdict(one), "ratio": ratio} for one, ratio in shares],
                }
            )
    Console().print(table)
    if args.json:
        write_json(args.json, {"command": command_line(), **host_facts(), "subjects": records})
    return 0


def add_rows(table: Table, subject: CodedData, figures: list[CoderFigures]) -> None:
    """Add a row per coder."""
    table.add_section()
    name, symbols = subject.name, max(subject.symbols, 1)
    if subject.baseline:
        table.add_row(name, "published", f"{subject.baseline:,}", "1.000")
        name = ""
    for one, ratio in zip(figures, ratios(subject, figures), strict=True):
        table.add_row(
            name,
            one.coder,
            f"{one.bytes:,}",
            "" if ratio is None else f"{ratio:.3f}",
            f"{8 * one.bytes / symbols:.3f}",
            f"{one.encode_seconds:.3f}",
            f"{one.decode_seconds:.3f}",
        )
        name = ""


def bench_subject(
    subject: CodedData, repeats: int, levels_only: bool, note: Note, advance: Callable[[], None]
) -> list[CoderFigures]:
    """Time every coder of the subject's kind; runs of all coders alternate.

    Raises:
        ClgsError: a coder gives back other numbers.
    """
    coders = _coders(subject)
    if not levels_only:
        coders += _others(subject, note)
    runs: dict[str, list[tuple[int, float, float]]] = {coder.name: [] for coder in coders}
    for repeat in range(repeats):
        for coder in coders:
            if repeat == 0 or not coder.once:
                runs[coder.name].append(_run(coder, subject))
                advance()
    return [
        CoderFigures(name, of[0][0], median(r[1] for r in of), median(r[2] for r in of), len(of))
        for name, of in runs.items()
    ]


def _run(coder: Coder, subject: CodedData) -> tuple[int, float, float]:
    """Bytes, and seconds to encode and decode."""
    start = time.perf_counter()
    data = coder.encode(subject.content)
    middle = time.perf_counter()
    decoded = coder.decode(data)
    end = time.perf_counter()
    if not _same(decoded, subject.content):
        raise ClgsError(f"{coder.name} gives back other numbers than those of {subject.name}")
    return len(data), middle - start, end - middle


def _same(decoded: Any, content: Any) -> bool:
    if isinstance(content, bytes | np.ndarray):
        return np.array_equal(decoded, content)
    return all(
        np.array_equal(getattr(decoded.anchors, name), array)
        for name, array in content.anchors.items()
    )


def _coders(subject: CodedData) -> list[Coder]:
    """Our own: one per level; positions have one only."""
    if subject.kind == "positions":
        one_thread = partial(encode_positions, threads=1), partial(decode_positions, threads=1)
        return [Coder("octree", *one_thread)]
    if subject.kind == "scene":
        read: Callable[[bytes], Any] = partial(decode, threads=1)
        return [Coder(level, partial(encode, level=level, threads=1), read) for level in LEVELS]
    return [
        Coder(
            level,
            partial(encode_attributes, level=level, threads=1),
            partial(decode_attributes, threads=1),
        )
        for level in LEVELS
    ]


def _others(subject: CodedData, note: Note) -> list[Coder]:
    """General-purpose compressors that are installed, on the narrowest integers, row by row."""
    if isinstance(subject.content, QuantizedScene):
        return []
    narrow, widen = _narrow(subject.content)
    once = len(narrow(subject.content)) > SLOW
    return [
        Coder(name, _chained(narrow, pack), _chained(unpack, widen), once)
        for name, pack, unpack in _compressors(note)
    ]


def _chained(first: Callable[[Any], bytes], second: Callable[[bytes], Any]) -> Callable[[Any], Any]:
    return lambda content: second(first(content))


def _narrow(content: Ints) -> tuple[Callable[[Ints], bytes], Callable[[bytes], Ints]]:
    """To and from the bytes of the smallest dtype that holds the numbers minus their least."""
    low = content.min(axis=0, initial=0).astype(np.int64)
    span = int((content - low).max(initial=0))
    dtype = next(d for d in (np.uint8, np.uint16, np.uint32) if span <= np.iinfo(d).max)

    def widen(data: bytes) -> Ints:
        rows = np.frombuffer(data, dtype).reshape(content.shape) + low
        return np.asarray(rows, np.int32)

    return lambda array: (array - low).astype(dtype).tobytes(), widen


Compressor = tuple[str, Callable[[bytes], bytes], Callable[[bytes], bytes]]


def _compressors(note: Note) -> Iterable[Compressor]:
    zstd = _optional("zstandard", note)
    if zstd:
        yield (
            "zstd -19",
            lambda data: zstd.ZstdCompressor(level=19).compress(data),
            lambda data: zstd.ZstdDecompressor().decompress(data),
        )
    yield "xz -9", lambda data: lzma.compress(data, preset=9), lzma.decompress
    brotli = _optional("brotli", note)
    if brotli:
        yield "brotli 11", lambda data: brotli.compress(data, quality=11), brotli.decompress


def _optional(name: str, note: Note) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        note(f'{name} is not installed and is left out: pip install "clgs[bench]"')
        return None


def ratios(subject: CodedData, figures: Sequence[CoderFigures]) -> list[float | None]:
    """Bytes of every coder by those of the baseline: the published coder's, or else ``paper``'s."""
    base = subject.baseline or next((f.bytes for f in figures if f.coder == "paper"), None)
    return [f.bytes / base if base else None for f in figures]
