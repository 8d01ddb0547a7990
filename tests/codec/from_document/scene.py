"""Part 3, and all parts of a scene put together."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

from tests.codec.from_document.attributes import Attributes
from tests.codec.from_document.chunks import SECTIONS, Chunks, Part, read_chunks
from tests.codec.from_document.common import ByteReader, check, crc32c, morton_code, xxh64
from tests.codec.from_document.octree import decode_octree
from tests.codec.from_document.prediction import near_rows
from tests.codec.from_document.weights import COUNT, decode_weights

CHANNELS = {"OFFS": 30, "FEAT": 50, "SCAL": 6}
LEVELS = ("fast", "default", "max", "paper")


@dataclass
class Meta:
    """The fields of META."""

    anchors: int
    q: tuple[float, ...]
    centre: tuple[float, ...]
    scale: float
    background: tuple[float, ...]
    near: float
    alpha_cut: float
    alpha_max: float
    transmittance_stop: float
    blur: float
    content_hash: int
    origin: tuple[int, ...]
    depth: int
    level: str


@dataclass
class Scene:
    """A decoded scene."""

    meta: Meta
    positions: np.ndarray
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    weights: np.ndarray | None = None


def read_meta(data: bytes) -> Meta:
    """META, every field checked."""
    check(len(data) == 168, f"META: {len(data)} bytes")
    reader = ByteReader(data, "META")
    anchors, *shape, zero, weights = reader.fields("I4HI")
    check(anchors <= 12_000_000, f"META: {anchors} anchors")
    check(shape == [10, 50, 6] and weights == COUNT, "META: shape")
    check(zero == 0, "META: reserved bytes")
    q = reader.fields("4d")
    centre = reader.fields("3d")
    scale = reader.fields("d")[0]
    background = reader.fields("3d")
    near, alpha_cut, alpha_max, stop, blur = reader.fields("5d")
    low, high = 2.0**-64, 2.0**64
    check(all(low <= v <= high for v in q), "META: Q out of range")
    check(all(abs(v) < float("inf") for v in centre), "META: centre is not finite")
    check(low <= scale <= high, "META: scale out of range")
    check(all(0 <= v <= 1 for v in background), "META: background out of range")
    check(low <= near <= high, "META: near plane out of range")
    check(0 < alpha_cut < 1, "META: alpha_cut out of range")
    check(alpha_cut < alpha_max <= 1, "META: alpha_max out of range")
    check(0 <= stop < 1, "META: transmittance_stop out of range")
    check(0 <= blur <= high, "META: blur out of range")
    content_hash = reader.number("Q")
    origin = reader.fields("3i")
    depth, level, zero = reader.fields("2BH")
    check(depth <= 21, f"META: depth {depth}")
    check(level < 4, f"META: level {level}")
    check(zero == 0, "META: reserved bytes")
    check(anchors > 0 or (*origin, depth) == (0, 0, 0, 0), "META: grid without anchors")
    return Meta(anchors, q, centre, scale, background, near, alpha_cut, alpha_max, stop, blur,
                content_hash, origin, depth, LEVELS[level])  # fmt: skip


def chunk_cell(chunk: Part, meta: Meta) -> tuple[list[int], int]:
    """Origin and depth of a chunk's octree in mode 3 (part 6)."""
    low = [v - o for v, o in zip(chunk.least, meta.origin, strict=True)]
    high = [v - o for v, o in zip(chunk.greatest, meta.origin, strict=True)]
    depth = max((a ^ b).bit_length() for a, b in zip(low, high, strict=True))
    return [o + (v >> depth << depth) for v, o in zip(low, meta.origin, strict=True)], depth


class SceneDecoder:
    """Decodes a scene chunk by chunk."""

    def __init__(self, sections: dict[str, bytes]) -> None:
        self.sections = sections
        self.meta = read_meta(sections["META"])
        lengths = [len(sections[tag]) for tag in SECTIONS]
        meta = self.meta
        self.chunks: Chunks = read_chunks(
            sections["CHNK"], lengths, meta.anchors, meta.origin, meta.depth
        )
        self.readers = {tag: ByteReader(sections[tag], tag) for tag in SECTIONS}
        self.decoders: dict[str, Attributes] = {}
        for k, tag in enumerate(SECTIONS):
            header = self.readers[tag].take(self.chunks.header_lengths[k])
            check(crc32c(header) == self.chunks.header_crcs[k], f"{tag}: header CRC differs")
            if tag != "ANCH":
                self.decoders[tag] = Attributes(header, CHANNELS[tag], tag)
        self.last_code = -1

    def positions(self, chunk: Part, data: bytes, number: int) -> list[list[int]]:
        """The positions of a chunk."""
        what = f"ANCH chunk {number}"
        check(crc32c(data) == chunk.crc_anchors, f"{what}: CRC differs")
        points = decode_octree(data, chunk.anchors, what, chunk_cell(chunk, self.meta))
        check(
            [min(axis) for axis in zip(*points, strict=True)] == chunk.least,
            f"{what}: least corner",
        )
        check(
            [max(axis) for axis in zip(*points, strict=True)] == chunk.greatest,
            f"{what}: greatest corner",
        )
        for point in points:
            code = morton_code(*(v - o for v, o in zip(point, self.meta.origin, strict=True)))
            check(code > self.last_code, f"{what}: not in Morton order")
            self.last_code = code
        return points

    def decode(self) -> Scene:
        """The scene."""
        positions: list[list[int]] = []
        parts: dict[str, list[np.ndarray]] = {tag: [] for tag in CHANNELS}
        for number, chunk in enumerate(self.chunks.chunks):
            bytes_of = {
                tag: self.readers[tag].take(s) for tag, s in zip(SECTIONS, chunk.sizes, strict=True)
            }
            points = self.positions(chunk, bytes_of.pop("ANCH"), number)
            positions += points
            check(crc32c(b"".join(bytes_of.values())) == chunk.crc_others,
                  f"chunk {number}: CRC differs")  # fmt: skip
            for tag, data in bytes_of.items():
                decoder = self.decoders[tag]
                near = near_rows(points) if decoder.looks_near else None
                parts[tag].append(decoder.decode(data, chunk.anchors, number, near))
        scene = Scene(self.meta, np.array(positions, "<i4").reshape(-1, 3))
        for tag, columns in CHANNELS.items():
            empty = np.empty((0, columns), "<i4")
            scene.attributes[tag] = np.concatenate([empty, *parts[tag]])
        scene.weights = decode_weights(self.sections["MLPS"])
        self.verify(scene)
        return scene

    def verify(self, scene: Scene) -> None:
        """Compare the content hash."""
        arrays = [scene.positions, *scene.attributes.values(), scene.weights]
        hashes = [xxh64(array.tobytes()) for array in arrays if array is not None]
        content = xxh64(struct.pack("<5Q", *hashes))
        check(content == self.meta.content_hash, "META: content hash differs")
