"""The third result of ``clgs.rasterization``: what lies between Gaussians and pictures.

The keys, shapes and units are gsplat's. An array is downloaded or computed when it is first asked
for.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.opencl.device import Device
from clgs.ops.tiles import tile_count
from clgs.render.channel_picture import Drawn, lists_of


class RasterizationMeta(MutableMapping[str, Any]):
    """A dictionary whose arrays are made at first use; see :func:`meta_of` for its keys."""

    def __init__(self, known: dict[str, Any], makers: dict[str, Callable[[], Any]]) -> None:
        """``makers``: how to make what is not known, by key."""
        self._known, self._makers = dict(known), dict(makers)

    def __getitem__(self, key: str) -> Any:
        if key not in self._known:
            self._known[key] = self._makers[key]()
        return self._known[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._known[key] = value

    def __delitem__(self, key: str) -> None:
        if key not in self:
            raise KeyError(key)
        self._known.pop(key, None)
        self._makers.pop(key, None)

    def __contains__(self, key: object) -> bool:
        return key in self._known or key in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._known | self._makers)

    def __len__(self) -> int:
        return len(self._known | self._makers)

    def copy(self) -> dict[str, Any]:
        """A dictionary of all arrays."""
        return dict(self)

    def __or__(self, other: Mapping[str, Any]) -> dict[str, Any]:
        return {**self, **other}

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        # What makes arrays cannot be stored, nor can a record, which belongs to a device;
        # torch.load takes this type from anybody's file.
        return OrderedDict, ({key: self[key] for key in self if key != "record"},)


def meta_of(
    device: Device,
    drawn: list[Drawn],
    batch: tuple[int, ...],
    cameras: int,
    count: int,
    size: tuple[int, int],
    packed: bool,
    radii: Callable[[], npt.NDArray[np.int32]] | None = None,
) -> RasterizationMeta:
    """Describe pictures, batches first, of ``count`` Gaussians each.

    With ``packed`` the arrays list what is drawn, M rows, and batch_ids, camera_ids and
    gaussian_ids (M,) int64 say whose they are; else those are None, and the arrays are (..., C, N).
    radii (2) int32: half sizes of boxes, pixels, 0 if culled; means2d (2) pixels; depths; conics
    (3): inverse covariances xx, xy, yy; opacities: compensated ones, if they are; tiles_per_gauss
    int32. isect_ids (I,) int64: bits of picture, tile and depth of every entry of the tile lists;
    flatten_ids (I,) int32: its row in the arrays; isect_offsets (..., C, rows, columns) int32.
    ``radii``: makes those of (pictures, N, 2), if they are kept elsewhere.
    """
    shape = (*batch, cameras, count)

    def projected(name: str, *width: int) -> npt.NDArray[Any]:
        arrays = [device.download(getattr(one.projected, name)) for one in drawn]
        return np.array(arrays, np.float32).reshape(len(drawn), count, *width)

    def radii_of() -> npt.NDArray[np.int32]:
        return radii() if radii else np.asarray(np.ceil(projected("extent", 2)), np.int32)

    @cache
    def ids() -> tuple[npt.NDArray[np.int64], ...]:
        """Picture, batch, camera and Gaussian of each packed row."""
        image, gaussian = np.divmod(np.flatnonzero(radii_of()[..., 0]), max(count, 1))
        return image, *np.divmod(image, max(cameras, 1)), gaussian

    def shaped(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if packed:
            return np.asarray(array[ids()[0], ids()[3]])
        return array.reshape(*shape, *array.shape[2:])

    columns, rows = tile_count(size[0], 1), tile_count(1, size[1])
    known = {
        "tile_width": columns,
        "tile_height": rows,
        "width": size[0],
        "height": size[1],
        "tile_size": TILE_SIZE,
        "n_batches": int(np.prod(batch)),
        "n_cameras": cameras,
    }

    def ranges(name: str, length: int) -> npt.NDArray[np.int32]:
        found = [device.download(getattr(lists_of(device, one), name)) for one in drawn]
        return np.array(found, np.int32).reshape(len(drawn), length + 1)

    def offsets() -> npt.NDArray[np.int32]:
        found = ranges("tile_range", columns * rows)
        before = np.cumsum(found[:, -1]) - found[:, -1]
        return (found[:, :-1] + before[:, None]).astype(np.int32)

    def entries() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        return _entries(device, drawn, columns * rows, radii_of() if packed else None)

    makers: dict[str, Callable[[], Any]] = {
        "batch_ids": lambda: ids()[1] if packed else None,
        "camera_ids": lambda: ids()[2] if packed else None,
        "gaussian_ids": lambda: ids()[3] if packed else None,
        "radii": lambda: shaped(radii_of()),
        "means2d": lambda: shaped(projected("mean2d", 2)),
        "depths": lambda: shaped(projected("depth")),
        "conics": lambda: shaped(conics_of(projected("whitening", 3))),
        "opacities": lambda: shaped(projected("opacity")),
        "tiles_per_gauss": lambda: shaped(np.diff(ranges("row_range", count))),
        "isect_ids": lambda: entries()[0],
        "flatten_ids": lambda: entries()[1],
        "isect_offsets": lambda: offsets().reshape(*batch, cameras, rows, columns),
    }
    return RasterizationMeta(known, makers)


def conics_of(whitening: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Inverse covariances (..., 3), xx, xy, yy, of whitening factors."""
    r1, lean, r2 = np.moveaxis(whitening, -1, 0)
    return np.stack([r1**2 + (lean * r2) ** 2, -lean * r2**2, r2**2], axis=-1)


def _entries(
    device: Device, drawn: list[Drawn], tiles: int, radii: npt.NDArray[np.int32] | None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
    """isect_ids and flatten_ids; ``radii`` (pictures, N, 2): of which rows count, None: all do."""
    ids, flat = [np.empty(0, np.int64)], [np.empty(0, np.int32)]
    number = None if radii is None else np.cumsum(radii[..., 0].ravel() > 0) - 1
    for picture, one in enumerate(drawn):
        lists, count = lists_of(device, one), len(one.projected.opacity)
        first = device.download(lists.tile_range)
        gaussian = device.download(lists.gaussian)[: first[-1]]
        depth = device.download(one.projected.depth)[gaussian].view(np.int32)
        tile = np.repeat(np.arange(tiles, dtype=np.int64), np.diff(first))
        image = np.int64(picture) << (tiles.bit_length() + 32)
        ids.append(image | tile << 32 | depth)
        row = picture * count + gaussian
        flat.append((row if number is None else number[row]).astype(np.int32))
    return np.concatenate(ids), np.concatenate(flat)
