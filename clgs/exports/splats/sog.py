"""Ordinary Gaussians as a SOG file, version 2; ``clgs.data.splats.sog`` says what it holds."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.splats.sog import (
    COORDINATE_STEPS,
    META,
    MODEL,
    PALETTE_COLUMNS,
    ROTATION_TAG,
    VERSION,
    decode_sog,
)
from clgs.exports.splats.ply import Encoded, as_read, file_units
from clgs.scene.gaussians import HostGaussians, sigmoid, smallest_three, unit_rotation
from clgs.scene.scene import IDENTITY, SceneTransform
from clgs.scene.world import to_text

Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

EARLIEST = (1980, 1, 1, 0, 0, 0)
"""The date of all files in the archive, so that equal scenes give equal bytes."""
TABLE_SIZE = 256
TABLE_ROUNDS = 20
PALETTE_PARTS = 128
"""The sets are first divided into this number of parts, then each part is divided."""
MAX_PALETTE = 65536
MEMBERS = 2
"""Gaussians for each entry of a palette, on average."""
PALETTE_ROUNDS = 8
SEED = 0


@dataclass(frozen=True)
class Palette:
    """Sets of coefficients: entries (P, C - 1, 3) uint8 point into the table (256,) float32.

    label (N,) int64: the entry of each Gaussian.
    """

    entries: npt.NDArray[np.uint8]
    table: Floats
    label: npt.NDArray[np.int64]

    def values(self) -> Floats:
        """The coefficients (N, C - 1, 3) of the Gaussians."""
        return np.asarray(self.table[self.entries[self.label]])


def encode_sog(gaussians: HostGaussians, transform: SceneTransform = IDENTITY) -> Encoded:
    """The file of N Gaussians, at least one, in the world's units of ``transform``."""
    position, log_scale, _ = file_units(gaussians, transform)
    logs = np.sign(position) * np.log1p(np.abs(position))
    least, most = logs.min(axis=0), logs.max(axis=0)
    span = np.where(most > least, most - least, 1.0)
    coordinates = np.rint((logs - least) / span * COORDINATE_STEPS).astype(np.int64)
    scale_table, color_table = make_table(log_scale), make_table(gaussians.sh[:, 0])
    opacity = np.rint(255 * sigmoid(gaussians.opacity)).astype(np.uint8)
    largest, others = smallest_three(unit_rotation(gaussians.rotation))
    small = np.rint(255 * (others / np.sqrt(2) + 0.5)).astype(np.uint8)
    images = {
        "means_l": (coordinates & 255).astype(np.uint8),
        "means_u": (coordinates >> 8).astype(np.uint8),
        "scales": nearest(scale_table, log_scale),
        "quats": np.column_stack([small, (ROTATION_TAG + largest).astype(np.uint8)]),
        "sh0": np.column_stack([nearest(color_table, gaussians.sh[:, 0]), opacity]),
    }
    files = {f"{name}.webp": _webp(_square(image)) for name, image in images.items()}
    meta: dict[str, Any] = {
        "version": VERSION,
        "asset": {"generator": "clgs"},
        "count": len(gaussians),
        "means": {
            "mins": least.tolist(),
            "maxs": most.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scale_table.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_table.tolist(), "files": ["sh0.webp"]},
    }
    if world := to_text(transform.frame, transform.place):
        meta["asset"]["world"] = world
    if gaussians.antialiased:
        meta |= {"model": MODEL, "antialias": True}
    if gaussians.degree:
        palette = make_palette(gaussians.sh[:, 1:])
        meta["shN"] = {
            "count": len(palette.entries),
            "bands": gaussians.degree,
            "codebook": palette.table.tolist(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
        count, size, _ = palette.entries.shape
        rows = -(-count // PALETTE_COLUMNS)
        entries = np.zeros((rows * PALETTE_COLUMNS, size, 3), np.uint8)
        entries[:count] = palette.entries
        labels = np.column_stack([palette.label & 255, palette.label >> 8]).astype(np.uint8)
        files["shN_centroids.webp"] = _webp(entries.reshape(rows, PALETTE_COLUMNS * size, 3))
        files["shN_labels.webp"] = _webp(_square(np.pad(labels, ((0, 0), (0, 1)))))
    files = {META: json.dumps(meta, separators=(",", ":")).encode(), **files}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, EARLIEST), data)
    return Encoded(buffer.getvalue(), as_read(decode_sog(buffer.getvalue()), transform))


def _square(values: Bytes) -> Bytes:
    """(N, 3 or 4) as an image, almost a square, sides multiples of 4, filled up with zeros."""
    count, channels = values.shape
    width = 4 * int(np.ceil(np.sqrt(count) / 4))
    height = 4 * int(np.ceil(count / width / 4))
    image = np.zeros((height * width, channels), np.uint8)
    image[:count] = values
    return image.reshape(height, width, channels)


def _webp(image: Bytes) -> bytes:
    """Lossless, colors below alpha 0 kept."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", lossless=True, exact=True, quality=100, method=4)
    return buffer.getvalue()


def make_table(values: Floats) -> Floats:
    """256 ascending numbers near which all ``values`` lie: means of nearest ones, repeated.

    An entry that no value is nearest to, as most are if one value lies far from all others, parts
    the values of another entry, where the squares of the errors add up to most.
    """
    ordered = np.sort(values, axis=None).astype(np.float64)
    share = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
    # half by rank, half by size: many values, and those far out, get their entries
    by_rank = ordered[(share * len(ordered)).astype(int)]
    by_size = ordered[0] + share * (ordered[-1] - ordered[0])
    table = np.sort(0.5 * (by_rank + by_size))
    for _ in range(TABLE_ROUNDS):
        bounds = np.searchsorted(ordered, 0.5 * (table[1:] + table[:-1]))
        first = np.r_[0, bounds]
        count = np.diff(np.r_[first, len(ordered)])
        used, idle = np.flatnonzero(count), np.flatnonzero(count == 0)
        table[used] = np.add.reduceat(ordered, first[used]) / count[used]
        error = np.square(ordered - np.repeat(table, count))
        sums = np.zeros(TABLE_SIZE)
        sums[used] = np.add.reduceat(error, first[used])
        worst = np.argsort(-sums, kind="stable")[: len(idle)]
        worst = worst[sums[worst] > 0]
        spread = np.sqrt(sums[worst] / count[worst])
        table[idle[: len(worst)]] = table[worst] + spread
        table[worst] -= spread
        table.sort()
    return table.astype(np.float32)


def nearest(table: Floats, values: Floats) -> npt.NDArray[np.uint8]:
    """Which entry of an ascending table is nearest to each value."""
    bounds = 0.5 * (table[1:].astype(np.float64) + table[:-1])
    return np.searchsorted(bounds, values).astype(np.uint8)


def make_palette(coefficients: Floats) -> Palette:
    """A palette for N sets of coefficients (N, C - 1, 3): half as many, at most MAX_PALETTE."""
    count, size, _ = coefficients.shape
    rows = coefficients.reshape(count, -1)
    wanted = min(MAX_PALETTE - PALETTE_PARTS, max(1, count // MEMBERS))
    centres, label = _cluster_in_two(rows, wanted)
    table = make_table(centres)
    return Palette(nearest(table, centres).reshape(-1, size, 3), table, label)


def _cluster_in_two(rows: Floats, wanted: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """About ``wanted`` centres, and the one of each row; parts first, then each part.

    Every part has one at least: there may be PALETTE_PARTS more than wanted.
    """
    rng = np.random.default_rng(SEED)
    _, part = _cluster(rows, min(PALETTE_PARTS, wanted), rng)
    label = np.empty(len(rows), np.int64)
    centres, used = [], 0
    for number in np.unique(part):
        members = np.flatnonzero(part == number)
        share = wanted * len(members) // len(rows)
        found, own = _cluster(rows[members], max(1, share), rng)
        label[members] = used + own
        centres.append(found)
        used += len(found)
    return np.concatenate(centres), label


def _cluster(
    rows: Floats, wanted: int, rng: np.random.Generator
) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Lloyd's rounds from rows drawn at random; centres without rows stay where they are."""
    centres = rows[np.sort(rng.permutation(len(rows))[:wanted])]
    for _ in range(PALETTE_ROUNDS):
        label = _closest(rows, centres)
        count = np.bincount(label, minlength=len(centres))
        order = np.argsort(label, kind="stable")
        used = np.flatnonzero(count)
        first = np.concatenate([[0], np.cumsum(count)[:-1]])[used]
        sums = np.add.reduceat(rows[order], first, axis=0)
        centres = centres.copy()
        centres[used] = sums / count[used, None]
    return centres, _closest(rows, centres)


def _closest(rows: Floats, centres: Floats) -> npt.NDArray[np.int64]:
    square = 0.5 * np.square(centres).sum(axis=1)
    return np.concatenate(
        [
            np.argmin(square - rows[start : start + 8192] @ centres.T, axis=1)
            for start in range(0, len(rows), 8192)
        ]
    )
