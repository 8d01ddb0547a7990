"""How far images and gradients are from float64: scenes, measures and a table of the worst.

    python -m tests.stress.tiers [cpu|gpu]

Tier 1: float64 takes the kernels' decisions, so that rounding is all that is left to differ.
Tier 2: float64 decides itself; a pair of pixel and splat at the alpha cut may then flip.
Tier 3, float64 gradients against central differences, is in test_differences.py.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clgs.constants import ALPHA_CUT
from clgs.reference import blend as blend_reference
from clgs.reference import project as project_reference
from clgs.reference import tiles as tiles_reference
from clgs.scene.camera import Camera
from tests.compare import relative_l2
from tests.gaussians import GaussianScene
from tests.stress.cases import (
    LEVEL,
    Drawn,
    draw,
    gradients,
    image_gradient,
    matched,
    space_scene,
    straight_camera,
    trained,
)

SIZES = ((48, 40), (96, 80))
Case = tuple[GaussianScene, Camera]


@dataclass(frozen=True)
class Kind:
    """One family of scenes: Gaussians per 1,000 pixels, sizes in pixels, and what is special."""

    density: float
    sigma: float
    ratio: float
    spread: float = 0.6
    focal: float = 1.0
    change: Callable[[GaussianScene], GaussianScene] = lambda scene: scene
    needles: bool = False


def with_opacity(low: float, high: float) -> Callable[[GaussianScene], GaussianScene]:
    """Opacities evenly from ``low`` to ``high``."""

    def change(scene: GaussianScene) -> GaussianScene:
        values = np.random.default_rng(0).uniform(low, high, len(scene.opacity))
        return replace(scene, opacity=values.astype(np.float32))

    return change


def flat(scene: GaussianScene) -> GaussianScene:
    """Discs: two long axes."""
    longest = scene.scale.max(axis=1, keepdims=True)
    thin = scene.scale == scene.scale.min(axis=1, keepdims=True)
    return replace(scene, scale=np.where(thin, scene.scale, longest))


KINDS = {
    "small": Kind(300, 1.1, 3),
    "medium": Kind(100, 3.5, 3),
    "large": Kind(20, 15, 3),
    "screen-filling": Kind(10, 100, 3),
    "below a pixel": Kind(300, 0.2, 3),
    "round": Kind(100, 3, 1),
    "faint": Kind(150, 6, 3, change=with_opacity(0.005, 0.04)),
    "opaque": Kind(100, 3, 3, change=with_opacity(0.9, 1.0)),
    "off axis": Kind(30, 25, 4, spread=1.5),
    "wide angle": Kind(100, 3, 3, focal=0.3),
    "telephoto": Kind(100, 3, 3, focal=12.0),
    "discs": Kind(40, 8, 20, change=flat),
    "needles": Kind(80, 12, 30),
    "long needles": Kind(30, 300, 3000, needles=True),
    "extreme needles": Kind(30, 4e4, 4e5, needles=True),
}


@dataclass(frozen=True)
class Limits:
    """The largest errors of a tier-1 scene: the image in levels, then gradients, relative."""

    p999: float = 1e-3
    largest: float = 5e-3
    relative: float = 1e-5
    cosine: float = 1e-9
    bias: float = 1e-6
    element99: float = 3e-4
    element999: float = 2e-3


TYPICAL = Limits()
NEEDLES = Limits(5e-3, 2e-2, 1e-3, 1e-6, 1e-4, 1e-2, 1e-1)
"""The limits of long needles, and of needles as long as float32 allows."""


def limits_of(kind: str) -> Limits:
    """What section 4 of the numerics notes allows a kind of scene."""
    return NEEDLES if KINDS[kind].needles else TYPICAL


def scene_of(kind: str, size: tuple[int, int], seed: int = 0) -> Case:
    """The seeded scene of a kind and size, and its camera."""
    spec = KINDS[kind]
    camera = straight_camera(*size, spec.focal * max(size))
    rng = np.random.default_rng([seed, *size, *kind.encode()])
    count = max(4, round(spec.density * size[0] * size[1] / 1000))
    scene = space_scene(rng, count, camera, spec.sigma, spec.ratio, spec.spread)
    return spec.change(scene), camera


def gradient_errors(actual: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    """Relative L2, 1 - cosine, signed bias, and quantiles of the error by element."""
    one, other = np.asarray(actual, np.float64), np.asarray(wanted, np.float64)
    floor = np.maximum(np.abs(other), 1e-3 * np.sqrt(np.mean(other**2)))
    element = np.abs(one - other) / floor
    norms = np.linalg.norm(one) * np.linalg.norm(other)
    return {
        "relative": relative_l2(one, other),
        "cosine": float(1 - np.sum(one * other) / norms),
        "bias": float(abs(np.sum(one - other)) / np.sum(np.abs(other))),
        "element99": float(np.quantile(element, 0.99)),
        "element999": float(np.quantile(element, 0.999)),
    }


def tier1(drawn: Drawn, d_image: np.ndarray) -> dict[str, dict[str, float]]:
    """Errors of the image ("p999", "largest", levels) and of every gradient, decisions matched."""
    expected = matched(drawn, d_image)
    error = np.abs(drawn.image - expected.image) / LEVEL
    found = {"image": {"p999": float(np.quantile(error, 0.999)), "largest": float(error.max())}}
    actual = trained(drawn.scene, gradients(drawn, d_image))
    for name, wanted in trained(drawn.scene, expected.gradients).items():
        found[name] = gradient_errors(actual[name], wanted)
    return found


@dataclass(frozen=True)
class Free:
    """Tier 2 of one scene: error in levels by pixel, and how near its nearest pair is to the cut.

    ``nearest`` is the smallest |log2(alpha / cut)| of the pixel's pairs, in float64.
    """

    error: np.ndarray
    nearest: np.ndarray


def tier2(drawn: Drawn, whole: bool) -> Free:
    """Against float64 with its own lists, order, cuts and stops.

    ``whole``: projected in float64 as well; else from the kernels' float32 splats.
    """
    scene = drawn.scene
    wide = {name: getattr(scene, name).astype(np.float64) for name in vars(scene)}
    if whole:
        shape = (wide["mean"], wide["scale"], wide["rotation"], wide["opacity"])
        projected = project_reference.forward(*shape, drawn.camera)
    else:
        names = ("mean2d", "whitening", "depth", "extent")
        arrays = {name: drawn.projected(name).astype(np.float64) for name in names}
        projected = project_reference.Projected(**arrays)
    lists = tiles_reference.forward(projected, wide["opacity"], *drawn.size)
    background = drawn.device.download(drawn.rendered.inputs["background"]).astype(np.float64)
    expected = blend_reference.forward(
        projected, wide["color"], wide["opacity"], lists, background, drawn.size
    )
    error = np.abs(drawn.image - expected.image).max(axis=0) / LEVEL
    return Free(error, nearest_to_cut(projected, wide["opacity"], error > 0.1))


def nearest_to_cut(projected: Any, opacity: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Smallest |log2(alpha / cut)| over all drawn splats, for the chosen pixels; else 0."""
    found = np.zeros(chosen.shape)
    drawn = projected.extent[:, 0] > 0
    r1, slope, r2 = projected.whitening[drawn].T
    for row, column in np.argwhere(chosen):
        dx = column + 0.5 - projected.mean2d[drawn, 0]
        dy = row + 0.5 - projected.mean2d[drawn, 1]
        power = 0.5 * ((dx * r1) ** 2 + ((dy - slope * dx) * r2) ** 2)
        exponent = np.log2(opacity[drawn] / ALPHA_CUT) - power / np.log(2)
        found[row, column] = np.abs(exponent).min()
    return found


def worst_of_tier1(device: Any) -> dict[str, Any]:
    """Largest value of every measure by kind of scene; gradients: over all five tensors."""
    table: dict[str, dict[str, float]] = {}
    for kind in KINDS:
        row = table.setdefault(kind, {})
        for size in SIZES:
            scene, camera = scene_of(kind, size)
            for errors in tier1(draw(device, scene, camera), image_gradient(camera)).values():
                for name, value in errors.items():
                    row[name] = max(row.get(name, 0.0), value)
    return table


def main() -> None:
    from clgs.opencl.device import Device

    device = Device(specialisation=(sys.argv[1:] or ["cpu"])[0])
    table = worst_of_tier1(device)
    names = list(next(iter(table.values())))
    print(f"tier 1, {len(KINDS)} kinds of scenes at {SIZES}, {device.name}")
    print(f"{'':17s}" + "".join(f"{name:>12s}" for name in names))
    for kind, row in table.items():
        print(f"{kind:17s}" + "".join(f"{row[name]:12.1e}" for name in names))
    for whole, title in ((False, "same float32 splats"), (True, "float64 from the scene on")):
        found = [tier2(draw(device, *scene_of(kind, SIZES[1])), whole) for kind in KINDS]
        print(f"tier 2, {title}: pixels off by > 0.1 level, of how many, largest error in levels")
        for kind, one in zip(KINDS, found, strict=True):
            flips = int(np.sum(one.error > 0.1))
            print(f"{kind:17s}{flips:6d}{one.error.size:8d}{one.error.max():10.3f}", end="")
            print(f"   farthest from the cut: {one.nearest.max():.1e} (log2)")


if __name__ == "__main__":
    main()
