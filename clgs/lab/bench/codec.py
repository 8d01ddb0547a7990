"""`clgs bench codec`: size and speed of the codec and of general compressors, on one thread.

Measured are seeded arrays, or those of files.
"""

from __future__ import annotations

import importlib
import lzma
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.cli.display import Display
from clgs.cli.tell import tell
from clgs.codec import (
    decode_attributes,
    decode_positions,
    encode_attributes,
    encode_positions,
    morton_order,
)
from clgs.codec.meta import LEVELS
from clgs.codec.scene_decoder import decode
from clgs.codec.scene_encoder import encode
from clgs.codec.streams import check_integers
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.errors import ClgsError, CodecError, DataError
from clgs.lab.figures import show_table, write_figures
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_archive
from clgs.workflow.events import counter

Ints = npt.NDArray[np.int32]

ANCHORS, QUICK_ANCHORS = 312_238, 20_000
"""The mean of a published data set, and a size that takes seconds."""

KINDS = (".npz", ".clgs")

SPREADS = {"offset": 0.57, "feature": 0.96, "scaling": 6.0}
"""Scales of the Laplace distributions: 1.73, 2.43 and 5.03 bits a number once rounded, near the
1.68, 2.35 and 5.05 of the published data set."""


PUBLISHED_ATTRIBUTES = {
    "iid_offset": 252375,
    "iid_feat": 588078,
    "iid_scale": 151649,
    "chan_feat": 530467,
    "zi_offset": 239515,
    "corr_weak": 556432,
    "corr_scale": 144476,
    "biker_scale_q8": 324445,
    "biker_color": 469109,
}
"""Bytes of known arrays by G-PCC's attribute residual coder as the paper's code calls it."""

PUBLISHED_POSITIONS = {
    "scene_q200": 484946,
    "armadillo_sparse_1024": 51899,
    "armadillo_dense_1024": 242340,
    "bunny_4096": 464382,
    "bunny_noisy_2048": 534403,
    "biker_1628": 160897,
    "biker_407": 49801,
}
"""Bytes of known clouds by G-PCC tmc13 v23: lossless octree geometry, the paper's settings."""


@dataclass(frozen=True)
class CodedData:
    """What is coded: ``content`` rows (N, channels) or positions (N, 3) int32, or a scene."""

    name: str
    kind: str  # attributes, positions or scene
    content: Ints | QuantizedScene

    @property
    def symbols(self) -> int:
        """Numbers of attributes, points of positions, anchors of a scene."""
        if isinstance(self.content, QuantizedScene):
            return len(self.content.anchors)
        return self.content.size if self.kind == "attributes" else len(self.content)

    @property
    def baseline(self) -> int | None:
        """Bytes of the published coder, if they are known."""
        known = {"attributes": PUBLISHED_ATTRIBUTES, "positions": PUBLISHED_POSITIONS}
        return known.get(self.kind, {}).get(self.name)


def seeded_scene(anchors: int, seed: int) -> QuantizedScene:
    """Independent Laplace numbers of about ``anchors`` points on bent sheets, in Morton order."""
    rng = np.random.default_rng(seed)
    # voxels of three noisy bent sheets, unique, in Morton order
    side = int(np.sqrt(2 * anchors)) + 2
    u, v = rng.uniform(-1, 1, (2, 2 * anchors))
    sheet = rng.integers(0, 3, 2 * anchors)
    height = 0.3 * np.sin(3 * u + sheet) * np.cos(2 * v) + 0.4 * sheet
    points = np.stack([u, v, height + rng.normal(0, 0.002, len(u))], 1)
    position = np.unique(np.rint(points * side / 2).astype(np.int32), axis=0)
    position = rng.permutation(position)[:anchors]
    position = position[morton_order(position)]
    count = len(position)

    def draw(kind: str, channels: int) -> Ints:
        return np.rint(rng.laplace(0, SPREADS[kind], (count, channels))).astype(np.int32)

    quantised = QuantizedAnchors(
        position,
        draw("offset", 3 * K_OFFSETS).reshape(count, K_OFFSETS, 3),
        draw("feature", FEATURE_DIM),
        draw("scaling", 6),
    )
    weights = np.rint(rng.laplace(0, 100, MLP_SIZE)).astype(np.float32) / np.float32(1024)
    return QuantizedScene(quantised, Mlps(weights), QuantizationScales())


def scene_subjects(name: str, scene: QuantizedScene) -> list[CodedData]:
    """The parts of a scene, each alone, and the whole file."""
    a = scene.anchors
    parts = {"offset": a.offset.reshape(len(a), 3 * K_OFFSETS), "feature": a.feature}
    parts["scaling"] = a.scaling
    return [
        *[CodedData(f"{name} {part}", "attributes", rows) for part, rows in parts.items()],
        CodedData(f"{name} position", "positions", a.position),
        CodedData(f"{name} file", "scene", scene),
    ]


def file_subjects(paths: Iterable[Path]) -> list[CodedData]:
    """Read .npz files (``values`` or ``positions``) and .clgs files; folders mean their files.

    Raises:
        DataError: no such file, or none of these kinds.
    """
    found: list[CodedData] = []
    for path in paths:
        files = (
            [f for f in path.iterdir() if f.suffix.lower() in KINDS] if path.is_dir() else [path]
        )
        if not files:
            raise DataError(f"{path}: no .npz or .clgs files; name a folder that has some")
        for file in sorted(files):
            found += _read(file)
    return found


def _read(file: Path) -> list[CodedData]:
    try:
        if file.suffix.lower() == ".clgs":
            return scene_subjects(file.stem, decode(file.read_bytes()))
        with file.open("rb") as opened, load_archive(opened) as arrays:
            name = "positions" if "positions" in arrays else "values"
            rows = arrays[name]
    except OSError as error:
        raise DataError(f"{file}: {error.strerror or error}; name a .npz or .clgs file") from error
    except CodecError as error:
        raise DataError(f"{file}: {error}") from error
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        problem = "is no .npz archive with `values` or `positions`, and no .clgs file"
        raise DataError(f"{file}: {problem}; name another") from error
    if rows.ndim != 2 or rows.dtype.kind not in "iu":
        raise DataError(f"{file}: {name} is {rows.dtype} {rows.shape}; (N, channels) integers")
    try:
        rows = check_integers(name, rows)
    except CodecError as error:
        raise DataError(f"{file}: {error}") from error
    if name == "values":
        return [CodedData(file.stem, "attributes", rows)]
    return [CodedData(file.stem, "positions", rows[morton_order(rows)])]


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
) -> None:
    """Measure, print and, if asked, write JSON."""
    if data:
        subjects = file_subjects(data)
    else:
        count = anchors or (QUICK_ANCHORS if quick else ANCHORS)
        subjects = scene_subjects("seeded", seeded_scene(count, seed))
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
