"""A scene for the page's tests, and its camera."""

from dataclasses import replace

import numpy as np

from clgs.codec.splat_packing import QuantizedSplats
from clgs.lab.scenes import anchor_scene
from clgs.scene.anchors import QuantizationScales, quantize, take
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene

SCALES = QuantizationScales(200.0, 16.0, 16.0, 32.0)


def quantized_scene(gaussians: int, size: int) -> tuple[QuantizedScene, Camera]:
    """About ``gaussians`` neural Gaussians on grey, seen by a camera of ``size`` x ``size``."""
    scene, camera = anchor_scene(gaussians, size, seed=3)
    anchors = quantize(scene.anchors, SCALES)
    _, first = np.unique(anchors.position, axis=0, return_index=True)
    settings = replace(scene.settings, background=(0.5, 0.25, 0.125))
    return QuantizedScene(take(anchors, first), scene.mlps, SCALES, settings), camera


def splat_names(rest: int) -> list[str]:
    """Properties of 3DGS files with ``rest`` coefficients beyond the first of all colors."""
    names = ["x", "y", "z", "nx", *(f"f_dc_{i}" for i in range(3))]
    names += [f"f_rest_{i}" for i in range(rest)]
    return [*names, "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def random_splats(
    rng: np.random.Generator, count: int, rest: int = 45, lattice: int = 1
) -> QuantizedSplats:
    """Splats in a small box, several in some voxels; positions are multiples of ``lattice``."""
    names = splat_names(rest)
    values = rng.integers(-40, 40, (count, len(names))).astype(np.int32)
    values[:, :3] = lattice * rng.integers(-9, 9, (count, 3))
    return QuantizedSplats(names, [2.0**-6] * 3 + [2.0**-5] * (len(names) - 3), values)


def grey_wall() -> QuantizedSplats:
    """Two opaque splats of f_dc = -1, which is sRGB 56, large enough to fill a view."""
    names = splat_names(0)
    values = np.zeros((2, len(names)), np.int32)
    values[:, 4:7], values[:, 7], values[:, 8:11], values[:, 11] = -1, 20, 4, 1
    return QuantizedSplats(names, [1.0] * len(names), values)
