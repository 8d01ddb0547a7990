"""The small sections of a scene: META, GEOR, PHOT, LAYR and MLPS (codec_c/FORMAT.md on each).

META has counts, scales, transform, render settings and a hash, GEOR what the world of the scene is,
PHOT how photos saw it, LAYR which chunks are a layer and the hash of each. The weights of the MLPs
are integers if they are multiples, else floats.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec import row_coder
from clgs.codec.octree import MAX_DEPTH
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.options import MAX_LAYERS
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.camera import UNKNOWN, PhotoRange
from clgs.scene.mlps import MATRICES, MLP_SIZE
from clgs.scene.scene import RenderSettings, SceneTransform, check_ranges
from clgs.scene.world import LOCAL, Place, is_world

SCALING_DIM = 6
MAX_ANCHORS = 12_000_000
"""The most anchors that a file holds; their integers take 4 GiB."""

LEVELS = row_coder.LEVELS
"""How much time the encoder spends; a file holds the place in this list."""

_META = struct.Struct("<IHHHHI16d8s3iBBH")
_SHAPE = (K_OFFSETS, FEATURE_DIM, SCALING_DIM, 0, MLP_SIZE)


@dataclass(frozen=True)
class Meta:
    """The contents of META.

    ``content_hash``: 8 bytes, of the decoded arrays; positions lie in ``origin`` + [0, 2^depth) on
    every axis; ``level``: one of LEVELS, that of the encoder.
    """

    anchors: int
    scales: QuantizationScales
    transform: SceneTransform
    settings: RenderSettings
    content_hash: bytes
    origin: tuple[int, int, int]
    depth: int
    level: str

    def pack(self) -> bytes:
        """The bytes of the section."""
        scales, settings = self.scales, self.settings
        return _META.pack(
            self.anchors,
            *_SHAPE,
            *(scales.position, scales.offset, scales.feature, scales.scaling),
            *self.transform.centre,
            self.transform.scale,
            *settings.background,
            *(settings.near, settings.alpha_cut, settings.alpha_max),
            *(settings.transmittance_stop, settings.blur),
            self.content_hash,
            *(*self.origin, self.depth, LEVELS.index(self.level), 0),
        )


def check_meta(
    anchors: int, scales: QuantizationScales, transform: SceneTransform, settings: RenderSettings
) -> None:
    """Raise ValueError, naming the field, if no file may hold one of these numbers."""
    check_ranges(scales, transform, settings)
    if anchors > MAX_ANCHORS:
        raise ValueError(f"{anchors} anchors, at most {MAX_ANCHORS} fit a file")


def unpack_meta(data: bytes | memoryview) -> Meta:
    """Read section META.

    Raises:
        ValueError: wrong size, another network shape, or a number out of range.
    """
    if len(data) != _META.size:
        raise ValueError(f"{len(data)} bytes instead of {_META.size}")
    values = _META.unpack(data)
    if values[1:6] != _SHAPE:
        raise ValueError(f"shape is {values[1:6]}, this build reads {_SHAPE}")
    numbers = values[6:22]
    centre, background = numbers[4:7], numbers[8:11]
    *origin, depth, level, reserved = values[23:]
    if depth > MAX_DEPTH or level >= len(LEVELS) or reserved != 0:
        raise ValueError(f"depth {depth}, level {level} or the bytes after them are out of range")
    meta = Meta(
        anchors=values[0],
        scales=QuantizationScales(*numbers[0:4]),
        transform=SceneTransform((centre[0], centre[1], centre[2]), numbers[7]),
        settings=RenderSettings((background[0], background[1], background[2]), *numbers[11:16]),
        content_hash=values[22],
        origin=(origin[0], origin[1], origin[2]),
        depth=depth,
        level=LEVELS[level],
    )
    check_meta(meta.anchors, meta.scales, meta.transform, meta.settings)
    return meta


def content_arrays(
    anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]
) -> list[npt.NDArray[np.int32] | npt.NDArray[np.float32]]:
    """The arrays that the content hash covers, in its order."""
    return [anchors.position, anchors.offset, anchors.feature, anchors.scaling, weights]


def array_hash(array: npt.NDArray[np.int32] | npt.NDArray[np.float32]) -> int:
    """XXH64 of the numbers in row-major order, little-endian."""
    dtype = array.dtype.newbyteorder("<")
    return _codec.xxh64(np.ascontiguousarray(array, dtype))


def join_hashes(hashes: list[int]) -> bytes:
    """XXH64 (8 bytes, little-endian) of the arrays' hashes, each 8 bytes, little-endian."""
    return _codec.xxh64(struct.pack(f"<{len(hashes)}Q", *hashes)).to_bytes(8, "little")


def content_hash(anchors: QuantizedAnchors, weights: npt.NDArray[np.float32]) -> bytes:
    """The content hash (8 bytes, little-endian) of a scene, or of a layer of one."""
    return join_hashes([array_hash(array) for array in content_arrays(anchors, weights)])


_GEOR = struct.Struct("<II3d")


def pack_geor(frame: float, place: Place) -> bytes:
    """The bytes of the section."""
    return _GEOR.pack(int(frame), 0, *place)


def unpack_geor(data: bytes | memoryview) -> tuple[int, Place]:
    """Read the frame and the place.

    Raises:
        ValueError: wrong size, or a number out of range.
    """
    if len(data) != _GEOR.size:
        raise ValueError(f"{len(data)} bytes instead of {_GEOR.size}")
    frame, zero, *place = _GEOR.unpack(data)
    found = place[0], place[1], place[2]
    if frame == LOCAL or zero or not is_world(frame, found):
        raise ValueError(f"frame {frame} with place {found} is out of range")
    return frame, found


_PHOT = struct.Struct("<7d")


def pack_phot(photos: PhotoRange) -> bytes:
    """The bytes of the section."""
    return _PHOT.pack(*photos)


def unpack_phot(data: bytes | memoryview) -> PhotoRange:
    """Read the bounds.

    Raises:
        ValueError: wrong size, or a number out of range.
    """
    if len(data) != _PHOT.size:
        raise ValueError(f"{len(data)} bytes instead of {_PHOT.size}")
    photos = PhotoRange(*_PHOT.unpack(data))
    if problem := photos.problem():
        raise ValueError(problem)
    if photos == UNKNOWN:
        raise ValueError("it says nothing")
    return photos


_COUNT = struct.Struct("<I")
_LAYER = struct.Struct("<IQ")


@dataclass(frozen=True)
class Layer:
    """Chunks that follow those of the layer before; ``content_hash``: as META's, of this layer."""

    chunks: int
    content_hash: bytes


def pack_layers(layers: list[Layer]) -> bytes:
    """Section LAYR."""
    rows = (
        _LAYER.pack(layer.chunks, int.from_bytes(layer.content_hash, "little")) for layer in layers
    )
    return _COUNT.pack(len(layers)) + b"".join(rows)


def unpack_layers(data: bytes | memoryview, chunks: int) -> list[Layer]:
    """The layers of a file of ``chunks`` chunks.

    Raises:
        ValueError: another length, a number out of range, or chunks that do not add up.
    """
    count = _COUNT.unpack_from(data)[0] if len(data) >= _COUNT.size else 0
    if not 1 <= count <= MAX_LAYERS or len(data) != _COUNT.size + count * _LAYER.size:
        raise ValueError(f"{len(data)} bytes do not hold 1 to {MAX_LAYERS} layers")
    rows = _LAYER.iter_unpack(data[_COUNT.size :])
    layers = [Layer(number, content.to_bytes(8, "little")) for number, content in rows]
    if min(layer.chunks for layer in layers) < 1:
        raise ValueError("a layer has no chunks")
    if sum(layer.chunks for layer in layers) != chunks:
        raise ValueError(f"the layers do not have {chunks} chunks in all")
    return layers


WEIGHT_MODES = ("auto", "float32")
"""auto: integers if that is shorter; float32: the bytes of the floats in any case."""

Matrices = Sequence[tuple[int, int]]


def pack_weights(
    weights: npt.NDArray[np.float32], mode: str = "auto", matrices: Matrices = MATRICES
) -> bytes:
    """The stream of ``weights`` (n,) float32, bit for bit.

    Weights are coded as integers if those of every matrix are multiples, below 2^24, of a power of
    two, none is -0, and this is shorter.

    Args:
        weights: of all matrices, one after another, each row-major.
        mode: one of WEIGHT_MODES.
        matrices: (rows, columns) of each.

    Raises:
        ValueError: the matrices do not hold n weights.
    """
    word = np.ascontiguousarray(weights, np.float32).view(np.uint32)
    if mode == "float32":
        return _codec.planes_encode(word)
    return _codec.weights_encode(word, np.array(matrices, np.uint32))


def unpack_weights(
    data: bytes | memoryview, matrices: Matrices = MATRICES
) -> npt.NDArray[np.float32]:
    """The weights (n,) float32 of ``matrices`` (rows, columns).

    Raises:
        ValueError: the stream is damaged, or holds another number of weights.
    """
    word = np.empty(sum(rows * columns for rows, columns in matrices), np.uint32)
    _codec.weights_decode(data, word, np.array(matrices, np.uint32))
    return word.view(np.float32)
