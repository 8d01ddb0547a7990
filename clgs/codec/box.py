"""The anchors in a box of the dataset, read from a file without the rest of it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec.container import section_table
from clgs.codec.container.meta import Meta
from clgs.codec.container.reader import Reader
from clgs.codec.container.source import Source
from clgs.codec.scene_decoder import decode_chunks, decode_positions
from clgs.codec.workers import workers
from clgs.errors import UsageError
from clgs.scene.anchors import QuantizedAnchors, take
from clgs.scene.scene import QuantizedScene


@dataclass(frozen=True)
class Box:
    """lower <= x < upper on every axis, in the units of the input data; ends may be infinite.

    Raises:
        UsageError: an end is not a number, or a lower end is not below the upper one.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise UsageError(f"box: {axis} from {low:g} to {high:g} is empty; lower end first")

    def holds(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Whether each of ``points`` (N, 3) lies in the box."""
        return np.asarray(((points >= self.lower) & (points < self.upper)).all(axis=1))

    def meets(
        self, least: npt.NDArray[np.float64], greatest: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        """Whether each of the closed boxes with these corners (N, 3) has a point in this one."""
        return np.asarray(((greatest >= self.lower) & (least < self.upper)).all(axis=1))


def decode_box(source: Source, box: Box, threads: int | None = None) -> QuantizedScene:
    """The scene with only the anchors whose position lies in ``box``.

    Only these are read: the section table, META, MLPS, the lists of chunks and the positions of
    those that meet the box, and the attributes of those that have an anchor in it. World positions
    are computed as for ``world_position`` of a scene archive.

    Raises:
        CodecError: not a .clgs file, of an unknown version, cut, or damaged in what is read.
    """
    reader = Reader(source, section_table.read_table(source))
    with workers(threads) as pool:
        weights = pool.submit(reader.weights)
        anchors = _decode_chunks(reader, box, pool)
    return reader.scene(anchors, weights.result())


def _decode_chunks(reader: Reader, box: Box, pool: ThreadPoolExecutor) -> QuantizedAnchors:
    meta = reader.meta
    met = reader.chunks(lambda *corners: box.meets(*(_world(c, meta) for c in corners)))
    opened = decode_positions(reader, met, pool)
    inside = [box.holds(_world(one.position, meta)) for one in opened]
    used = [i for i, kept in enumerate(inside) if kept.any()]
    anchors = decode_chunks(reader, [opened[i] for i in used], pool)
    return take(anchors, np.concatenate([np.empty(0, bool), *(inside[i] for i in used)]))


def _world(position: npt.NDArray[np.integer[Any]], meta: Meta) -> npt.NDArray[np.float64]:
    """Positions (A, 3) in the units of the input data; on each axis it never decreases."""
    return meta.transform.to_world(position / np.float64(meta.scales.position))
