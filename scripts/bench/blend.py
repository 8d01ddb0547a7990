"""Time the blend kernels against a naive loop in C, which does the same work.

naive_blend.c takes one pixel after the other, with expf, an early exit and tiles of 16x16
(`gcc -O3 -march=native -fopenmp`). It walks lists made from the bounding boxes of the Gaussians.
The kernels walk their own lists. Their time holds everything from Gaussians and lists to the
picture, and from the picture's gradient to those of the Gaussians. Lists are made beforehand for
both. Runs take turns; times are medians.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

os.environ["OMP_WAIT_POLICY"] = "passive"  # threads that spin after the C loop slow what follows

import numpy as np
import numpy.typing as npt

from clgs.lab.figures import take_turns
from clgs.lab.selftest.reference_render import box_lists, relative_l2
from clgs.opencl.device import Device
from clgs.ops import blend, tiles
from clgs.ops.project import Projected

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.gaussians import ProjectedScene, projected_scene

COMPILER = ("gcc", "-O3", "-march=native", "-fopenmp", "-shared", "-fPIC")
BACKGROUND = np.array([0.2, 0.5, 0.9], np.float32)
SCENE_ARRAYS = (
    "tile_range", "gaussian", "mean2d", "whitening", "color", "opacity", "background",
)  # fmt: skip
ROW = 9
"""Floats of a Gaussian's gradient."""

Array = npt.NDArray[Any]


BLEND_SCENES = {"small 200k": (200_000, 400, 1.2), "medium 50k": (50_000, 800, 5.2)}
"""Gaussians, pixels of the image's edge, and median size in pixels, by name."""


class SceneOfC(ctypes.Structure):
    """The structure Scene of naive_blend.c."""

    _fields_ = (
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in SCENE_ARRAYS),
    )


class NaiveBlend:
    """The loop in C, a scene with its lists, and room for what the functions compute."""

    def __init__(self, scene: ProjectedScene, size: tuple[int, int], d_image: Array) -> None:
        """``d_image``: gradient of the picture, (3, H, W)."""
        width, height = size
        self.count = len(scene.opacity)
        lists = box_lists(Projected(**vars(scene)), *size)
        found = {name: vars(lists)[name].astype(np.int32) for name in ("tile_range", "gaussian")}
        self._arrays = {**vars(scene), **found, "background": BACKGROUND}
        self._scene = SceneOfC(width, height, *(self._arrays[n].ctypes.data for n in SCENE_ARRAYS))
        self.image = np.zeros((3, height, width), np.float32)
        transmittance = np.zeros((height, width), np.float32)
        last = np.zeros((height, width), np.int32)
        self._forward = self.image, transmittance, last
        place = np.argsort(lists.row).astype(np.int32)
        self._backward = transmittance, last, d_image, place, lists.row_range.astype(np.int32)
        self._rows = np.zeros((len(place), ROW), np.float32)
        self.gradients = np.zeros((self.count, ROW), np.float32)

    def forward(self) -> None:
        """Render."""
        arrays = (ctypes.c_void_p(array.ctypes.data) for array in self._forward)
        naive_library().naive_forward(ctypes.byref(self._scene), *arrays)

    def backward(self) -> None:
        """Compute the gradients of all Gaussians."""
        read, made = (
            [ctypes.c_void_p(array.ctypes.data) for array in arrays]
            for arrays in (self._backward, (self._rows, self.gradients))
        )
        count = ctypes.c_int(self.count)
        naive_library().naive_backward(ctypes.byref(self._scene), *read, count, *made)


@cache
def naive_library() -> ctypes.CDLL:
    """naive_blend.c, compiled."""
    source = Path(__file__).with_name("naive_blend.c")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "naive_blend.so"
        subprocess.run([*COMPILER, str(source), "-o", str(target), "-lm"], check=True)
        return ctypes.CDLL(str(target))


def measure(device: Device, name: str, repeats: int) -> dict[str, float]:
    """All figures of one scene; the errors show that both do the same work."""
    count, edge, sigma = BLEND_SCENES[name]
    size = (edge, edge)
    scene = projected_scene(np.random.default_rng(0), count, *size, sigma)
    d_host = np.random.default_rng(1).normal(size=(3, size[1], size[0])).astype(np.float32)
    naive = NaiveBlend(scene, size, d_host)
    projected = Projected(**{field: device.upload(x) for field, x in vars(scene).items()})
    lists = tiles.forward(device, projected, size)
    background, d_image = device.upload(BACKGROUND), device.upload(d_host)
    blended = blend.forward(device, projected, lists, background)

    def forward() -> None:
        blend.forward(device, projected, lists, background)
        device.finish()

    def backward() -> None:
        blend.backward(device, projected, blended, d_image)
        device.finish()

    runs = {"forward": forward, "backward": backward}
    runs |= {"naive forward": naive.forward, "naive backward": naive.backward}
    times = {run: median(each) for run, each in take_turns(runs, repeats).items()}
    gradients = blend.backward(device, projected, blended, d_image)
    error = np.abs(device.download(blended.image) - naive.image)
    return {
        "Gaussians": len(scene.opacity),
        **{f"{run}, ms": milliseconds for run, milliseconds in times.items()},
        "forward, times as fast": times["naive forward"] / times["forward"],
        "backward, times as fast": times["naive backward"] / times["backward"],
        "error of the picture, p99.9": float(np.quantile(error, 0.999)),
        "error of d_color": relative_l2(
            device.download(gradients.d_color), naive.gradients[:, 5:8]
        ),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(BLEND_SCENES)}; default all")
    add("--repeats", type=int, default=5, help="runs to take the median of")
    add("--device", help="number or part of the name, see `clgs devices`")
    args = parser.parse_args()
    device = Device(args.device)
    print(f"{device.name} ({device.specialisation})")
    for name in args.scenes or list(BLEND_SCENES):
        print(f"{name}:")
        for what, value in measure(device, name, args.repeats).items():
            print(f"  {what}: {value:.6g}")


if __name__ == "__main__":
    main()
