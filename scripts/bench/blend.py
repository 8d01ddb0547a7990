"""Time the blend kernels against a naive loop in C, and count the pairs that they visit.

Compared is the same work: naive_blend.c (one pixel after the other, expf, early exit, 16x16 tiles,
`gcc -O3 -march=native -fopenmp`) walks lists made from the bounding boxes of the Gaussians; the
kernels walk their own lists, and their time holds everything from Gaussians and lists to the
picture, and from the picture's gradient to those of the Gaussians, segmented sums included. With
--same-lists the C loop gets the kernels' lists, too. Lists are made beforehand for both. Runs are
interleaved, times are medians.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from statistics import median
from typing import Any

os.environ["OMP_WAIT_POLICY"] = "passive"  # threads that spin after the C loop slow what follows

import numpy as np
from naive import NaiveBlend, box_lists, squares_of_three_sigma

from clgs.lab.selftest.reference_render import relative_l2
from clgs.lab.synthetic.gaussians import BLEND_SCENES, ProjectedScene
from clgs.opencl import device as opencl_device
from clgs.opencl.device import Device
from clgs.ops import blend, tiles
from clgs.ops.project import Projected
from clgs.options import PRESETS, RenderOptions

BACKGROUND = np.array([0.2, 0.5, 0.9], np.float32)


class Ours:
    """A scene on the device, with its lists."""

    def __init__(
        self, device: Device, scene: ProjectedScene, size: tuple[int, int], options: RenderOptions
    ) -> None:
        self.device, self.options = device, options
        self.projected = Projected(**{name: device.upload(x) for name, x in vars(scene).items()})
        self.tiles = tiles.forward(device, self.projected, size, options)
        self.background = device.upload(BACKGROUND)
        rng = np.random.default_rng(1)
        self.host_d_image = rng.normal(size=(3, size[1], size[0])).astype(np.float32)
        self.d_image = device.upload(self.host_d_image)
        self.forward()
        self.backward()

    def forward(self) -> None:
        """Render."""
        self.blended = blend.forward(
            self.device, self.projected, self.tiles, self.background, self.options
        )
        self.device.finish()

    def backward(self) -> None:
        """Gradients of all Gaussians."""
        self.gradients = blend.backward(self.device, self.projected, self.blended, self.d_image)
        self.device.finish()

    def lists(self) -> dict[str, Any]:
        """Lists on the host: tile_range, gaussian."""
        names = ("tile_range", "gaussian")
        return {name: self.device.download(getattr(self.tiles, name)) for name in names}

    def pairs(self) -> dict[str, int]:
        """Visited and blended pairs of both passes."""
        forward, backward = blend.count_pairs(self.device, self.blended, self.d_image)
        return {
            "intersections": len(self.tiles.gaussian),
            "visited_forward": forward.visited,
            "visited_backward": backward.visited,
            "blended": forward.blended,
        }

    def disagreement(self, naive: NaiveBlend) -> dict[str, float]:
        """How far the two are apart, to show that they do the same work."""
        error = np.abs(self.device.download(self.blended.image) - naive.image)
        d_color = self.device.download(self.gradients.d_color)
        return {
            "image_p999": float(np.quantile(error, 0.999)),
            "d_color_relative_l2": relative_l2(d_color, naive.d_color),
        }


def milliseconds(run: Any) -> float:
    """Time of one call."""
    start = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - start)


def interleaved(runs: dict[str, Any], repeats: int) -> dict[str, float]:
    """Median milliseconds of each, taking turns."""
    for run in runs.values():
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            times[name].append(milliseconds(run))
    return {name: median(found) for name, found in times.items()}


def measure(device: Device, name: str, args: argparse.Namespace) -> dict[str, Any]:
    """All figures of one scene."""
    size, generate = BLEND_SCENES[name]
    scene = generate(np.random.default_rng(args.seed))
    ours = Ours(device, scene, size, RenderOptions(accuracy=PRESETS[args.accuracy]))
    lists = ours.lists() if args.same_lists else box_lists(scene, size)
    found: dict[str, Any] = {"scene": name, "gaussians": len(scene.opacity), **ours.pairs()}
    runs = {"forward": ours.forward, "backward": ours.backward}
    if not args.only_ours:
        naive = NaiveBlend(scene, size, lists, BACKGROUND, ours.host_d_image)
        runs |= {"naive_forward": naive.forward, "naive_backward": naive.backward}
    times = interleaved(runs, args.repeats)
    found |= {f"{run}_ms": value for run, value in times.items()}
    for which in ("forward", "backward"):
        found[f"{which}_ns_per_blended"] = 1e6 * times[which] / found["blended"]
    found["visited_per_blended"] = found["visited_forward"] / found["blended"]
    found["blended_per_pixel"] = found["blended"] / (size[0] * size[1])
    if not args.only_ours:
        squares = NaiveBlend(
            scene, size, squares_of_three_sigma(scene, size), BACKGROUND, ours.host_d_image
        )
        squares.forward()
        found |= ours.disagreement(naive)
        found["naive_intersections"] = len(lists["gaussian"])
        found["naive_visited"] = naive.visited()
        found["squares_intersections"] = len(squares.gaussian)
        found["squares_visited"] = squares.visited()
        found["tests_against_squares"] = found["visited_forward"] / squares.visited()
        for which in ("forward", "backward"):
            found[f"{which}_ratio"] = times[f"naive_{which}"] / times[which]
    return found


def denormals(device: Device, args: argparse.Namespace) -> dict[str, Any]:
    """Time with subnormal numbers possible over time with them flushed, on thin Gaussians."""
    size, generate = BLEND_SCENES["needles 20k"]
    scene = generate(np.random.default_rng(args.seed))
    flushing = opencl_device.BUILD_OPTIONS
    opencl_device.BUILD_OPTIONS = tuple(o for o in flushing if o != "-cl-denorms-are-zero")
    keeping = Device(args.device)
    kept = Ours(keeping, scene, size, RenderOptions())
    opencl_device.BUILD_OPTIONS = flushing
    flushed = Ours(device, scene, size, RenderOptions())
    runs = {
        f"{which}_{name}": getattr(ours, which)
        for name, ours in (("kept", kept), ("flushed", flushed))
        for which in ("forward", "backward")
    }
    times = interleaved(runs, args.repeats)
    return {
        f"denormals_{which}": times[f"{which}_kept"] / times[f"{which}_flushed"]
        for which in ("forward", "backward")
    }


def main() -> None:
    """Measure, print and, if asked, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(BLEND_SCENES)}; default all")
    add("--accuracy", choices=PRESETS, default="parity", help="preset of the kernels")
    add("--repeats", type=int, default=5, help="runs to take the median of")
    add("--seed", type=int, default=0, help="of the scenes")
    add("--device", help="number or part of the name, see `clgs devices`")
    add("--same-lists", action="store_true", help="give the kernels' lists to the C loop, too")
    add("--only-ours", action="store_true", help="leave out the C loop")
    add("--denormals", action="store_true", help="measure the cost of subnormal numbers, too")
    add("--json", type=Path, metavar="F", help="write the figures to F")
    args = parser.parse_args()
    device = Device(args.device)
    print(f"{device.name} ({device.specialisation})")
    found = [measure(device, name, args) for name in args.scenes or list(BLEND_SCENES)]
    for figures in found:
        print(
            *(
                f"  {k}: {v:.6g}" if isinstance(v, float) else f"{k}: {v}"
                for k, v in figures.items()
            ),
            sep="\n",
        )
    extra = denormals(device, args) if args.denormals else {}
    print(*(f"{name}: {value:.3g}" for name, value in extra.items()), sep="\n")
    if args.json:
        report = {"device": device.name, "scenes": found, **extra}
        args.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
