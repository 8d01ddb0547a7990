"""Whole files: parts 2, 3, 5 and 11 of FORMAT.md."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from .arrays import Corner, check_order, declared_shape, decode_attributes, decode_positions
from .attributes import Attributes, near_rows
from .coding import ByteReader, check, crc32c, in_int32, morton_code, xxh64
from .details import Details, add_details, products, read_details
from .octree import decode_octree
from .rows import WEIGHTS, decode_rows, decode_weights

MAGIC = bytes.fromhex("8B434C47530D0A1A")
SCENE = ("META", "CHNK", "ANCH", "OFFS", "FEAT", "SCAL", "MLPS")
SPLATS = ("SPLT", "SPOS", "SMUL", "SATR")
LAYERED = ("LAYR", "BODY")
DETAILED = ("LAYR", "DETL", "BODY")
CHUNKED = ("ANCH", "OFFS", "FEAT", "SCAL")
CHANNELS = {"OFFS": 30, "FEAT": 50, "SCAL": 6}
LEVELS = ("fast", "default", "max", "paper")


class Meta(NamedTuple):
    """The fields of section META."""

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


class Scene(NamedTuple):
    """A decoded scene: integers (N, 3), integers (N, channels) by section, weights f32.

    `layers`: how many of the file's layers it has, and how many the file was made with; 0 without.
    """

    meta: Meta
    positions: np.ndarray
    attributes: dict[str, np.ndarray]
    weights: np.ndarray
    layers: tuple[int, int] = (0, 0)


class Splats(NamedTuple):
    """Decoded splats: a value is an integer of (N, properties) times the property's step."""

    names: list[str]
    steps: list[float]
    integers: np.ndarray


class Extent(NamedTuple):
    """What CHNK says of a group or of a chunk; `sizes` are its bytes in CHUNKED."""

    anchors: int
    least: Corner
    greatest: Corner
    sizes: list[int]


class CutBytes(bytes):
    """The beginning of a section of `length` bytes."""

    length: int

    def __new__(cls, data: bytes, length: int) -> CutBytes:
        """What there is of it."""
        found = super().__new__(cls, data)
        found.length = length
        return found


def length_of(section: bytes) -> int:
    """How many bytes the table says that a section has."""
    return section.length if isinstance(section, CutBytes) else len(section)


def read_file(data: bytes) -> Scene | Splats:
    """What a whole .clgs file holds; ValueError if the document forbids the file."""
    sections = read_sections(data)
    return read_splats(sections) if "SPLT" in sections else SceneDecoder(sections).decode()


def read_sections(data: bytes) -> dict[str, bytes]:
    """The sections of a file that must be understood (part 2); BODY may be cut (5.3)."""
    check(data[:8] == MAGIC, "not a .clgs file")
    reader = ByteReader(data)
    _, _, major, _, count = reader.fields("IIHHI")
    check(major == 1, f"version {major} is not known")
    check(count <= 64, f"{count} sections")
    table = ByteReader(reader.take(32 * count))
    (header_crc,) = reader.fields("I")
    check(header_crc == crc32c(data[: 16 + 32 * count]), "the CRC of the header differs")
    required = SPLATS if table.data[:4] == b"SPLT" else SCENE
    seen: list[str] = []
    sections = {}
    for _ in range(count):
        name = table.take(4)
        flags, offset, length, crc, zero = table.fields("IQQII")
        check(name.isalpha(), f"a tag is {name!r}")  # of bytes: ASCII letters
        tag = name.decode("ascii")
        layered = required == SCENE and tag in DETAILED
        check(flags == (tag in required or layered), f"{tag}: flags {flags}")
        check(zero == 0, f"{tag}: the last field of its entry is not 0")
        check(offset == reader.at, f"{tag}: a gap or an overlap")
        check(tag not in seen, f"{tag}: occurs twice")
        seen.append(tag)
        if layered and tag == "BODY" and length > reader.left and not table.left:
            sections[tag] = CutBytes(reader.rest(), length)
            continue
        section = reader.take(length)
        check(crc32c(section) == crc, f"{tag}: the CRC differs")
        if tag in required or layered:
            sections[tag] = section
    reader.finish()
    tags = tuple(sections)
    last = tags[len(required) :]
    known = tags[: len(required)] == required and last in ((), LAYERED, DETAILED)
    check(known, f"the sections are {' '.join(sections)}")
    check(tuple(seen[len(seen) - len(last) :]) == last, "LAYR and BODY are not the last")
    return sections


def read_meta(data: bytes) -> Meta:
    """Section META (part 3), every field checked."""
    check(len(data) == 168, f"META: {len(data)} bytes")
    reader = ByteReader(data)
    anchors, *shape, zero, weights = reader.fields("I4HI")
    check(anchors <= 12_000_000, f"META: {anchors} anchors")
    check((*shape, zero, weights) == (10, 50, 6, 0, WEIGHTS), "META: another shape")
    q, centre, (scale,) = reader.fields("4d"), reader.fields("3d"), reader.fields("d")
    background = reader.fields("3d")
    near, alpha_cut, alpha_max, stop, blur = reader.fields("5d")
    low, high = 2.0**-64, 2.0**64
    check(all(low <= v <= high for v in (*q, scale, near)), "META: a scale is out of range")
    check(all(abs(v) < float("inf") for v in centre), "META: the centre is not finite")
    check(all(0 <= v <= 1 for v in background), "META: the background is out of range")
    check(0 < alpha_cut < 1 and alpha_cut < alpha_max <= 1, "META: an alpha is out of range")
    check(0 <= stop < 1, "META: transmittance_stop is out of range")
    check(0 <= blur <= high, "META: blur is out of range")
    (content_hash,) = reader.fields("Q")
    origin = reader.fields("3i")
    depth, encoder_level, zero = reader.fields("2BH")
    check(depth <= 21 and encoder_level < 4 and zero == 0, "META: depth, level or reserved bytes")
    check(anchors > 0 or (*origin, depth) == (0, 0, 0, 0), "META: a grid without anchors")
    return Meta(anchors, q, centre, scale, background, near, alpha_cut, alpha_max, stop, blur,
                content_hash, origin, depth, LEVELS[encoder_level])  # fmt: skip


def _extents(rows: list[list[int]], base: Corner, group: Extent | None) -> list[Extent]:
    """Rows of CHNK as groups, or as the chunks of a group."""
    found = []
    for row in rows:
        least = [b + v for b, v in zip(base, row[1:4], strict=True)]
        greatest = [b + v for b, v in zip(least, row[4:7], strict=True)]
        sizes = row[7:]
        check(row[0] >= 1, "CHNK: a group or a chunk without anchors")
        if group is not None:
            shares = [row[0] * s // group.anchors for s in group.sizes]
            sizes = [v + share for v, share in zip(sizes, shares, strict=True)]
        check(min(row[4:7]) >= 0, "CHNK: a greatest corner below the least")
        check(min(sizes) >= 0, "CHNK: a negative number of bytes")
        found.append(Extent(row[0], least, greatest, sizes))
        base = least
    return found


def _union(extents: list[Extent]) -> Extent:
    """The extent that holds all of them."""
    return Extent(
        sum(e.anchors for e in extents),
        [min(axis) for axis in zip(*(e.least for e in extents), strict=True)],
        [max(axis) for axis in zip(*(e.greatest for e in extents), strict=True)],
        [sum(sizes) for sizes in zip(*(e.sizes for e in extents), strict=True)],
    )


class Directory(NamedTuple):
    """What section CHNK says.

    `headers` has length and CRC of the header of each of CHUNKED; `chunks` has the extent of each
    chunk, the CRC of its positions and the CRC of its other parts. `details` is DETL, if any.
    """

    headers: list[tuple[int, int]]
    chunks: list[tuple[Extent, int, int]]
    details: Details | None


def read_layers(data: bytes, chunks: int) -> list[tuple[int, int]]:
    """Section LAYR (5.3): for each layer the number of its chunks, and its content hash."""
    reader = ByteReader(data)
    (count,) = reader.fields("I")
    check(1 <= count <= 64, f"LAYR: {count} layers")
    layers = [reader.fields("IQ") for _ in range(count)]
    reader.finish()
    check(all(number >= 1 for number, _ in layers), "LAYR: a layer without chunks")
    check(sum(number for number, _ in layers) == chunks, "LAYR: the chunks do not add up")
    return layers


def read_directory(sections: dict[str, bytes], meta: Meta) -> Directory:
    """Section CHNK (part 5), compared with META and with the lengths of the other sections."""
    data = sections["CHNK"]
    reader = ByteReader(data)
    most, count, *numbers, size, head_crc = reader.fields("12I")
    check(1 <= most <= 2**20, f"CHNK: chunks of {most} anchors")
    headers = list(zip(numbers[::2], numbers[1::2], strict=True))
    check(headers[0] == (0, 0), "CHNK: ANCH has a header")
    table = reader.take(8 * ((count + 63) // 64))
    rows = reader.take(size)
    check(crc32c(data[:44] + table + rows) == head_crc, "CHNK: the CRC of the head differs")
    groups = _extents(decode_rows(rows, len(table) // 8, 11), [0, 0, 0], None)
    whole = _union(groups) if groups else Extent(0, [], [], 4 * [0])
    in_body = "BODY" in sections
    details = read_details(sections["DETL"], count) if "DETL" in sections else None
    for tag, (length, _), bytes_of_chunks in zip(CHUNKED, headers, whole.sizes, strict=True):
        total = length + (0 if in_body else bytes_of_chunks)
        check(total == len(sections[tag]), f"CHNK: the bytes of {tag} do not add up")
    if in_body:
        total = sum(whole.sizes) + (details.total() if details else 0)
        check(total == length_of(sections["BODY"]), "CHNK: BODY does not add up")
    check(whole.anchors == meta.anchors, "CHNK: the anchors do not add up")
    if groups:
        corners = [v for group in groups for v in group.least + group.greatest]
        check(all(map(in_int32, corners)), "CHNK: a corner outside of int32")
        check(whole.least == list(meta.origin), "CHNK: the least corner is not META's origin")
        extent = max(g - o for g, o in zip(whole.greatest, meta.origin, strict=True))
        check(extent.bit_length() == meta.depth, "CHNK: the extent is not that of META's depth")
    found: list[tuple[Extent, int, int]] = []
    for group, (length, crc) in zip(groups, struct.iter_unpack("<2I", table), strict=True):
        part = ByteReader(reader.take(length))
        check(crc32c(part.data) == crc, "CHNK: the CRC of a group differs")
        in_group = min(64, count - len(found))
        crcs = part.fields(f"{2 * in_group}I")
        chunks = _extents(decode_rows(part.rest(), in_group, 11), group.least, group)
        for chunk in chunks:
            check(chunk.anchors <= most, f"CHNK: a chunk of {chunk.anchors} anchors")
            check(chunk.anchors <= 32768 * chunk.sizes[0], "CHNK: too few bytes in ANCH")
        check(_union(chunks) == group, "CHNK: the chunks of a group do not give its row")
        found += zip(chunks, crcs[:in_group], crcs[in_group:], strict=True)
    reader.finish()
    return Directory(headers, found, details)


class SceneDecoder:
    """Decodes the sections of a scene, chunk by chunk."""

    def __init__(self, sections: dict[str, bytes]) -> None:
        self.weights = sections["MLPS"]
        self.meta = read_meta(sections["META"])
        directory = read_directory(sections, self.meta)
        self.chunks, self.details = directory.chunks, directory.details
        self.readers = {tag: ByteReader(sections[tag]) for tag in CHUNKED}
        self.decoders: dict[str, Attributes] = {}
        for tag, (length, crc) in zip(CHUNKED, directory.headers, strict=True):
            header = self.readers[tag].take(length)
            check(crc32c(header) == crc, f"{tag}: the CRC of the header differs")
            if tag != "ANCH":
                self.decoders[tag] = Attributes(header, CHANNELS[tag])
        self.last_code = -1
        self.layers: list[tuple[int, int]] = []
        if "BODY" in sections:
            self.layers = read_layers(sections["LAYR"], len(self.chunks))
            body = ByteReader(sections["BODY"])
            self.readers = dict.fromkeys(CHUNKED, body)

    def positions(self, chunk: Extent, data: bytes, crc: int) -> list[list[int]]:
        """The positions of a chunk."""
        check(crc32c(data) == crc, "ANCH: the CRC of a chunk differs")
        origin = self.meta.origin
        low = [v - o for v, o in zip(chunk.least, origin, strict=True)]
        high = [v - o for v, o in zip(chunk.greatest, origin, strict=True)]
        depth = max((a ^ b).bit_length() for a, b in zip(low, high, strict=True))
        corner = [o + (v >> depth << depth) for v, o in zip(low, origin, strict=True)]
        points = decode_octree(data, chunk.anchors, (corner, depth))
        axes = list(zip(*points, strict=True))
        corners = [min(axis) for axis in axes], [max(axis) for axis in axes]
        check(corners == (chunk.least, chunk.greatest), "ANCH: a chunk has other corners")
        self.last_code = check_order(points, origin, self.last_code)
        return points

    def rows(self, chunks: list[tuple[Extent, int, int]]) -> tuple[np.ndarray, ...]:
        """Positions and attributes of chunks that follow those before, in one Morton order."""
        positions: list[list[int]] = []
        parts = {tag: [np.empty((0, columns), "<i4")] for tag, columns in CHANNELS.items()}
        for chunk, positions_crc, others_crc in chunks:
            anchors, *others = (
                self.readers[tag].take(size) for tag, size in zip(CHUNKED, chunk.sizes, strict=True)
            )
            points = self.positions(chunk, anchors, positions_crc)
            positions += points
            check(crc32c(b"".join(others)) == others_crc, "the CRC of a chunk differs")
            for (tag, decoder), data in zip(self.decoders.items(), others, strict=True):
                near = near_rows(points) if decoder.looks_near else None
                found = decoder.decode(data, chunk.anchors, near)
                parts[tag].append(products(found, self.details) if self.details else found)
        joined = (np.concatenate(arrays) for arrays in parts.values())
        return (np.array(positions, "<i4").reshape(-1, 3), *joined)

    def decode(self) -> Scene:
        """The scene, compared with its content hash; of a file that is cut the layers it has."""
        weights = decode_weights(self.weights)
        if not self.layers:
            arrays = self.rows(self.chunks)
            check(_hash(arrays, weights) == self.meta.content_hash, "META: the hash differs")
            return self.scene(arrays, weights)
        found, first = [], 0
        for number, expected in self.layers:
            chunks, first = self.chunks[first : first + number], first + number
            if sum(sum(chunk.sizes) for chunk, *_ in chunks) > self.readers["ANCH"].left:
                break
            self.last_code = -1
            found.append(self.rows(chunks))
            check(_hash(found[-1], weights) == expected, "LAYR: the hash of a layer differs")
        check(len(found) > 0, "the file is cut before its first layer ends")
        joined = tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True))
        there, layers, body = len(found), len(self.layers), self.readers["ANCH"]
        if self.details is not None:
            layers += 1
            if there == len(self.layers) and body.left == self.details.total():
                there += 1
                counts = [chunk.anchors for chunk, *_ in self.chunks]
                joined = add_details(self.details, body, joined, counts)
        codes = [morton_code(*(int(v) for v in point - self.meta.origin)) for point in joined[0]]
        order = sorted(range(len(codes)), key=codes.__getitem__)
        ordered = tuple(array[order] for array in joined)
        check_order(ordered[0].tolist(), self.meta.origin)
        if there == layers:
            check(_hash(ordered, weights) == self.meta.content_hash, "META: the hash differs")
        return self.scene(ordered, weights, (there, layers))

    def scene(
        self, arrays: tuple[np.ndarray, ...], weights: np.ndarray, layers: tuple[int, int] = (0, 0)
    ) -> Scene:
        """The scene of these arrays."""
        attributes = dict(zip(CHANNELS, arrays[1:], strict=True))
        return Scene(self.meta, arrays[0], attributes, weights, layers)


def _hash(arrays: tuple[np.ndarray, ...], weights: np.ndarray) -> int:
    """The content hash (part 3) of positions, attributes and weights."""
    hashes = (xxh64(array.tobytes()) for array in (*arrays, weights))
    return xxh64(struct.pack("<5Q", *hashes))


def read_splats(sections: dict[str, bytes]) -> Splats:
    """The splats of sections SPLT, SPOS, SMUL and SATR (part 11)."""
    reader = ByteReader(sections["SPLT"])
    n, voxels, properties, zero, content_hash = reader.fields("IIHHQ")
    check(zero == 0, "SPLT: reserved bytes")
    check(voxels <= n, "SPLT: more voxels than splats")
    check(4 <= properties <= 259, f"SPLT: {properties} properties")
    names, steps = [], []
    for _ in range(properties):
        step, length = reader.fields("dB")
        name = reader.take(length)
        check(2.0**-64 <= step <= 2.0**64, "SPLT: a step is out of range")
        check(length >= 1 and all(0x21 <= b <= 0x7E for b in name), "SPLT: a name")
        names.append(name.decode("ascii"))
        steps.append(step)
    reader.finish()
    check(len(set(names)) == properties, "SPLT: a name occurs twice")
    shapes = {"SPOS": (voxels, 3), "SMUL": (voxels, 1), "SATR": (n, properties - 3)}
    for tag, shape in shapes.items():
        check(declared_shape(sections[tag]) == shape, f"{tag}: rows or columns are not SPLT's")
    more = decode_attributes(sections["SMUL"])[:, 0]
    check(bool((more >= 0).all()), "SMUL: a number below 0")
    check(int(more.astype(np.int64).sum()) + voxels == n, "SMUL: the sum is not that of SPLT")
    positions = np.repeat(decode_positions(sections["SPOS"]), more + 1, axis=0)
    others = decode_attributes(sections["SATR"])
    integers = np.concatenate([positions, others], axis=1).astype("<i4")
    check(xxh64(integers.tobytes()) == content_hash, "SPLT: the content hash differs")
    return Splats(names, steps, integers)
