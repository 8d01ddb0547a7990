"""Section META: counts, scales, transform and render settings (codec_c/FORMAT.md, 2 and 10)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clgs.codec.octree.position_coder import MAX_DEPTH
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizationScales
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.ranges import check_ranges
from clgs.scene.scene import RenderSettings, SceneTransform

SCALING_DIM = 6
CONTENT_HASH_SIZE = 8
MAX_ANCHORS = 12_000_000
"""Anchors of one file: their integers take 4 GiB."""

LEVELS = ("fast", "default", "max", "paper")
"""How much time the encoder spent, by number."""

_COMMON = struct.Struct("<IHHHHI16d8s")
_GRID = struct.Struct("<3iBB2x")
_SHAPE = (K_OFFSETS, FEATURE_DIM, SCALING_DIM, 0, MLP_SIZE)


@dataclass(frozen=True)
class Grid:
    """Where the positions lie: in origin + [0, 2^depth) on every axis; and the encoder's level."""

    origin: tuple[int, int, int]
    depth: int
    level: str


@dataclass(frozen=True)
class Meta:
    """What META holds; ``content_hash`` of the decoded arrays; version 1 has no ``grid``."""

    anchors: int
    scales: QuantizationScales
    transform: SceneTransform
    settings: RenderSettings
    content_hash: bytes
    grid: Grid | None = None

    def pack(self) -> bytes:
        """The bytes of the section, in version 2 where there is a grid, else in version 1."""
        scales, settings = self.scales, self.settings
        common = _COMMON.pack(
            self.anchors,
            *_SHAPE,
            *(scales.position, scales.offset, scales.feature, scales.scaling),
            *self.transform.centre,
            self.transform.scale,
            *settings.background,
            *(settings.near, settings.alpha_cut, settings.alpha_max),
            *(settings.transmittance_stop, settings.blur),
            self.content_hash,
        )
        if self.grid is None:
            return common
        level = LEVELS.index(self.grid.level)
        return common + _GRID.pack(*self.grid.origin, self.grid.depth, level)

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(self.scales, self.transform, self.settings)
        if self.anchors > MAX_ANCHORS:
            raise ValueError(f"{self.anchors} anchors, at most {MAX_ANCHORS} fit a file")


def unpack_meta(data: bytes | memoryview, major: int) -> Meta:
    """Read section META of a file of version ``major``.

    Raises:
        ValueError: wrong size, another network shape, or a number out of range.
    """
    size = _COMMON.size + (_GRID.size if major > 1 else 0)
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes instead of {size}")
    values = _COMMON.unpack_from(data)
    if values[1:6] != _SHAPE:
        raise ValueError(f"shape is {values[1:6]}, this build reads {_SHAPE}")
    numbers = values[6:22]
    centre, background = numbers[4:7], numbers[8:11]
    meta = Meta(
        anchors=values[0],
        scales=QuantizationScales(*numbers[0:4]),
        transform=SceneTransform((centre[0], centre[1], centre[2]), numbers[7]),
        settings=RenderSettings((background[0], background[1], background[2]), *numbers[11:16]),
        content_hash=values[22],
        grid=_unpack_grid(bytes(data[_COMMON.size :])) if major > 1 else None,
    )
    meta.check()
    return meta


def _unpack_grid(data: bytes) -> Grid:
    x, y, z, depth, level = _GRID.unpack(data)
    if depth > MAX_DEPTH or level >= len(LEVELS) or data[14:] != b"\0\0":
        raise ValueError(f"depth {depth}, level {level} or the bytes after them are out of range")
    return Grid((x, y, z), depth, LEVELS[level])
