"""What the layers of a file show, and files of the same size: PSNR and bytes of every prefix.

``python scripts/bench/layers.py SCENE.clgs --data DATA [--downscale N] [--layers 4] [--views 4]``

The last line has, for each view, the share of the bytes of all chunks that a page fetches first.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from clgs.codec.reader import SceneReader
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode, suits_details
from clgs.codec.sections import BytesSource, read_table
from clgs.opencl.device import Device
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.scores import mean_psnr
from clgs.workflow.options import ViewOptions
from clgs.workflow.smaller import encode_within, importance_in_views
from clgs.workflow.views import drawing_options, select_views

WIDE = 0.5
"""Cosine, that of web/page/stream.js, of the angle from which on a camera does not see a chunk."""


def in_sight(data: bytes, scene: QuantizedScene, camera: Camera) -> float:
    """Share of the bytes of all chunks whose spheres ``camera`` sees, as a page decides it."""
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))
    seen = whole = 0
    for chunk in reader.chunks():
        ends = np.array([chunk.least, chunk.greatest]) / scene.scales.position
        away, radius = ends.mean(axis=0) - camera.centre, np.linalg.norm(np.ptp(ends, axis=0)) / 2
        depth = camera.rotation[2] @ away
        size, distance = chunk.end - chunk.start, np.linalg.norm(away)
        whole += size
        seen += size * bool(depth + radius >= WIDE * (distance - radius))
    return round(seen / whole, 3)


def main() -> None:
    """Print a line of JSON for every layer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--downscale", type=int)
    parser.add_argument("--layers", type=int, default=4)
    parser.add_argument("--views", type=int, default=4, help="held-out views, at most")
    parser.add_argument("--target", action="store_true", help="--target-size of each prefix, too")
    args = parser.parse_args()
    plain = args.scene.read_bytes()
    scene = decode(plain)
    views = ViewOptions(args.data, downscale=args.downscale)
    every = select_views(args.scene, scene, replace(views, split="test"))
    test = every[:: max(1, len(every) // args.views)][: args.views]
    device, options = Device(None), drawing_options(args.scene, views, scene)

    def psnr(shown: QuantizedScene) -> float:
        renderer = Renderer(device, shown.dequantize(), options)
        return round(mean_psnr(renderer, test, shown.settings.background), 2)

    orders = {"around": None, "views": importance_in_views(args.scene, scene, views)}
    for name, importance in orders.items():
        details = suits_details(scene, args.layers)
        data = encode(scene, layers=args.layers, importance=importance, details=details)
        overhead = round(100 * (len(data) / len(plain) - 1), 2)
        for number, layer in enumerate(describe(data)["layers"], 1):
            row = {"scene": args.scene.stem, "order": name, "layer": number, **layer}
            row |= {"of": len(data), "overhead": overhead}
            row["psnr"] = psnr(decode(data, layers=number))
            if args.target and number < args.layers:
                for known, chosen in {"plain": replace(views, data=None), "judged": views}.items():
                    found = encode_within(args.scene, scene, encode, chosen, layer["end"]).found
                    row[f"target_{known}"] = [len(found.data), psnr(found.scene)]
            print(json.dumps(row), flush=True)
    print(json.dumps({"in_sight": [in_sight(data, scene, view.camera) for view in test]}))


if __name__ == "__main__":
    main()
