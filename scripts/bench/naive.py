"""The naive blend in C: compiled on first use, called through ctypes."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.lab.synthetic.gaussians import ProjectedScene

COMPILER = ("gcc", "-O3", "-march=native", "-fopenmp", "-shared", "-fPIC")
ROW = 9
THREE_SIGMA = 3.0

Array = npt.NDArray[Any]


@cache
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_name("naive_blend.c")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "naive_blend.so"
        subprocess.run([*COMPILER, str(source), "-o", str(target), "-lm"], check=True)
        return ctypes.CDLL(str(target))


def _address(array: Array) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


class _Scene(ctypes.Structure):
    _fields_ = (
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "tile_range",
                "gaussian",
                "mean2d",
                "whitening",
                "color",
                "opacity",
                "background",
            )
        ),
    )


def _lists(scene: ProjectedScene, half: Array, size: tuple[int, int]) -> dict[str, Array]:
    """Lists of the Gaussians whose boxes, (N, 2) half sizes in pixels, overlap a tile."""
    counts = -(-np.array(size) // TILE_SIZE)
    first = np.clip(np.floor((scene.mean2d - half) / TILE_SIZE), 0, counts).astype(np.int64)
    end = np.clip(np.floor((scene.mean2d + half) / TILE_SIZE) + 1, 0, counts).astype(np.int64)
    spans = np.maximum(end - first, 0)
    number = spans.prod(axis=1) * (scene.extent[:, 0] > 0)
    order = np.argsort(scene.depth, kind="stable")
    gaussian = np.repeat(order, number[order])
    within = np.arange(len(gaussian)) - np.repeat(
        np.cumsum(number[order]) - number[order], number[order]
    )
    column = first[gaussian, 0] + within % spans[gaussian, 0]
    row = first[gaussian, 1] + within // spans[gaussian, 0]
    tile = row * counts[0] + column
    by_tile = np.argsort(tile, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=counts.prod()))])
    return {
        "tile_range": starts.astype(np.int32),
        "gaussian": gaussian[by_tile].astype(np.int32),
    }


def box_lists(scene: ProjectedScene, size: tuple[int, int]) -> dict[str, Array]:
    """From the boxes of visible alpha."""
    return _lists(scene, scene.extent, size)


def squares_of_three_sigma(scene: ProjectedScene, size: tuple[int, int]) -> dict[str, Array]:
    """From squares of three standard deviations along the longer axis, as 3DGS has them."""
    r1, l_factor, r2 = scene.whitening.astype(np.float64).T
    sigma = 1 / np.array([r1, r2])
    xx, xy = sigma[0] ** 2, l_factor * sigma[0] ** 2
    yy = l_factor**2 * xx + sigma[1] ** 2
    major = np.sqrt((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy))
    half = np.ceil(THREE_SIGMA * major)
    return _lists(scene, np.stack([half, half], axis=1), size)


class NaiveBlend:
    """A scene, its lists, and room for what the C functions compute."""

    def __init__(
        self,
        scene: ProjectedScene,
        size: tuple[int, int],
        lists: dict[str, Array],
        background: Array,
        d_image: Array,
    ) -> None:
        width, height = size
        self.gaussian, self.d_image = lists["gaussian"], d_image
        self.count = len(scene.opacity)
        arrays = {**vars(scene), **lists, "background": background}
        self._keep = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        names = [name for name, _ in _Scene._fields_[2:]]
        self._scene = _Scene(width, height, *(self._keep[n].ctypes.data for n in names))
        self.image = np.zeros((3, height, width), np.float32)
        self._transmittance = np.zeros((height, width), np.float32)
        self._last = np.zeros((height, width), np.int32)
        self._visited = np.zeros(len(lists["tile_range"]) - 1, np.int64)
        self._place = np.argsort(self.gaussian, kind="stable").astype(np.int32)
        numbers = np.bincount(self.gaussian, minlength=self.count)
        self._place_range = np.concatenate([[0], np.cumsum(numbers)]).astype(np.int32)
        self._rows = np.zeros((len(self.gaussian), ROW), np.float32)
        self._gradients = np.zeros((self.count, ROW), np.float32)

    def forward(self) -> None:
        """Render."""
        outputs = (self.image, self._transmittance, self._last, self._visited)
        _library().naive_forward(ctypes.byref(self._scene), *map(_address, outputs))

    def backward(self) -> None:
        """Gradients of all Gaussians."""
        read = (self._transmittance, self._last, self.d_image, self._place, self._place_range)
        _library().naive_backward(
            ctypes.byref(self._scene),
            *map(_address, read),
            ctypes.c_int(self.count),
            _address(self._rows),
            _address(self._gradients),
        )

    def visited(self) -> int:
        """Pairs of a pixel and an entry that the last rendering looked at."""
        return int(self._visited.sum())

    @property
    def d_color(self) -> Array:
        """(N, 3)."""
        return self._gradients[:, 5:8]
