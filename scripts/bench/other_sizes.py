"""PSNR of a scene at other sizes than its photos', with and without what it knows of them.

``python scripts/bench/other_sizes.py RUN --data DATA --downscale 1 2 4 8``: at most 20 held-out
views, reduced this many times, compared with photos that are reduced as often.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from clgs.codec.scene_decoder import decode
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import UNKNOWN
from clgs.train.quality.scores import mean_psnr
from clgs.workflow.options import ViewOptions
from clgs.workflow.views import drawing_options, select_views

VIEWS = 20


def main() -> None:
    """Print a line per size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--downscale", type=int, nargs="+", required=True)
    args = parser.parse_args()
    file, device = args.run / "scene.clgs", Device(None)
    found = decode(file.read_bytes())
    scene = found.dequantize()
    assert scene.settings.photos != UNKNOWN, "the file is of an older version"
    blind = replace(scene, settings=replace(scene.settings, photos=UNKNOWN))
    for times in args.downscale:
        views = ViewOptions(args.data, downscale=times, split="test")
        every = select_views(file, found, views)
        seen = every[:: max(1, len(every) // VIEWS)][:VIEWS]
        options = drawing_options(file, views, found)
        known, unknown = (
            mean_psnr(Renderer(device, one, options), seen, one.settings.background)
            for one in (scene, blind)
        )
        print(f"1/{times}: {known:.2f} dB, {unknown:.2f} dB without", flush=True)


if __name__ == "__main__":
    main()
