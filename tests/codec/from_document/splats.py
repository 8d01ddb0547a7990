"""Part 11: files of splats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.codec.from_document.common import ByteReader, check, xxh64
from tests.codec.from_document.streams import decode_attributes, decode_positions, peek_shape


@dataclass
class Splats:
    """Decoded splats: value = integer * step."""

    names: list[str]
    steps: list[float]
    integers: np.ndarray  # N x P, int32


def decode_splats(sections: dict[str, bytes]) -> Splats:
    """The splats of sections SPLT, SPOS, SMUL and SATR."""
    reader = ByteReader(sections["SPLT"], "SPLT")
    n, voxels, properties, zero, content_hash = reader.fields("IIHHQ")
    check(zero == 0, "SPLT: reserved bytes")
    check(voxels <= n, "SPLT: more voxels than splats")
    check(4 <= properties <= 259, f"SPLT: {properties} properties")
    names, steps = [], []
    for _ in range(properties):
        step, length = reader.fields("dB")
        name = reader.take(length)
        check(2.0**-64 <= step <= 2.0**64, "SPLT: step out of range")
        check(length >= 1 and all(0x21 <= b <= 0x7E for b in name), "SPLT: name")
        names.append(name.decode("ascii"))
        steps.append(step)
    reader.finish()
    check(len(set(names)) == properties, "SPLT: a name twice")
    shapes = {"SPOS": (voxels, 3), "SMUL": (voxels, 1), "SATR": (n, properties - 3)}
    for tag, shape in shapes.items():
        check(peek_shape(sections[tag]) == shape, f"{tag}: rows or columns are not those of SPLT")
    more = decode_attributes(sections["SMUL"], "SMUL")[:, 0]
    check(bool((more >= 0).all()), "SMUL: a number below 0")
    check(int(more.astype(np.int64).sum()) + voxels == n, "SMUL: sum")
    positions = np.repeat(decode_positions(sections["SPOS"], "SPOS"), more + 1, axis=0)
    others = decode_attributes(sections["SATR"], "SATR")
    integers = np.concatenate([positions, others], axis=1).astype("<i4")
    check(xxh64(integers.tobytes()) == content_hash, "SPLT: content hash differs")
    return Splats(names, steps, integers)
