"""Section META: counts, scales, transform and render settings (codec_c/FORMAT.md, part 2)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizationScales
from clgs.scene.mlps import MLP_SIZE
from clgs.scene.ranges import check_ranges
from clgs.scene.scene import RenderSettings, SceneTransform

SCALING_DIM = 6
CONTENT_HASH_SIZE = 8
_LAYOUT = struct.Struct("<IHHHHI16d8s")
_SHAPE = (K_OFFSETS, FEATURE_DIM, SCALING_DIM, 0, MLP_SIZE)


@dataclass(frozen=True)
class Meta:
    """What META holds; ``content_hash``: the first 8 bytes of SHA-256 over the decoded arrays."""

    anchors: int
    scales: QuantizationScales
    transform: SceneTransform
    settings: RenderSettings
    content_hash: bytes

    def pack(self) -> bytes:
        """The bytes of the section."""
        scales, settings = self.scales, self.settings
        return _LAYOUT.pack(
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

    def check(self) -> None:
        """Raise ValueError, naming the field, where a number makes no sense."""
        check_ranges(self.scales, self.transform, self.settings)


def unpack_meta(data: bytes | memoryview) -> Meta:
    """Read section META.

    Raises:
        ValueError: wrong size, another network shape, or a number out of range.
    """
    if len(data) != _LAYOUT.size:
        raise ValueError(f"{len(data)} bytes instead of {_LAYOUT.size}")
    values = _LAYOUT.unpack(data)
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
    )
    meta.check()
    return meta
