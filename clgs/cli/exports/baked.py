"""``clgs export SCENE -o x.ply|x.spz|x.sog|x.glb``: baked to ordinary 3D Gaussians."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.counted import counted
from clgs.cli.options.view import add_size_options, whole_number
from clgs.cli.tell import tell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clgs.bake.bake import BakedLoss, BakeView
    from clgs.data.dataset import Dataset
    from clgs.data.stored_photo import Planes
    from clgs.data.view import View
    from clgs.export.splats.encoded import Encoded
    from clgs.scene.gaussians import HostGaussians
    from clgs.scene.scene import QuantizedScene, Scene

DEGREES = (0, 1, 2, 3)
STEPS = 500
MOST_STEPS = 100_000
SCORED_VIEWS = 32
"""At most so many views, evenly chosen, say what baking costs."""


HELP = """\
from SCENE: baked to ordinary 3D Gaussians, for 3DGS viewers.
         With --data they are fitted to its photos; without, to renders from
         cameras around the scene, which is worse. A PLY of splats is
         converted. Coordinates are those of the data set."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of baking."""
    add = parser.add_argument
    add_size_options(parser, "SCENE")
    add(
        "--sh-degree",
        type=int,
        choices=DEGREES,
        default=DEGREES[-1],
        help="degree of the colors' spherical harmonics, at most (default: %(default)s)",
    )
    add(
        "--steps",
        type=_steps,
        default=STEPS,
        metavar="N",
        help="baking: steps of refinement after the fit; 0: none (default: %(default)s)",
    )
    add(
        "--units",
        choices=("data", "scene"),
        default="data",
        help="baking: coordinates of the data set, or the scene's own (default: %(default)s)",
    )
    add("--device", help="number or part of the name, see `clgs devices`")


def _steps(text: str) -> int:
    return 0 if text == "0" else whole_number(MOST_STEPS)(text)


def run(args: argparse.Namespace) -> None:
    """Bake, write the file and print what it costs."""
    from clgs.cli.options.scene import read_drawable
    from clgs.errors import UsageError
    from clgs.files import atomic_write, check_output
    from clgs.scene.scene import SplatScene

    if args.source is None:
        raise UsageError(f"a scene is needed: `clgs export SCENE -o {args.output.name}`")
    check_output(args.output, args.source)
    args.scene = args.source
    quantized, _ = read_drawable(args.source)
    if isinstance(quantized, SplatScene):
        encoded = _encode(args.output, _at_most(quantized.gaussians, args.sh_degree))
        line = f"converted: {len(encoded.data) / 1e6:.1f} MB"
    else:
        encoded, line = _bake(args, quantized)
    atomic_write(args.output, encoded.data)
    gaussians = encoded.gaussians
    print(f"{args.output}: {len(gaussians):,} Gaussians, degree {gaussians.degree}")
    print(line)


def _at_most(gaussians: HostGaussians, degree: int) -> HostGaussians:
    """Without the coefficients above ``degree``."""
    return replace(gaussians, sh=gaussians.sh[:, : (degree + 1) ** 2])


def _bake(args: argparse.Namespace, quantized: QuantizedScene) -> tuple[Encoded, str]:
    """The file, and the line that says what it costs."""
    from clgs.bake.bake import BakeSettings, bake, baked_loss, count_steps, to_scene, to_world
    from clgs.cli.progress import bar
    from clgs.opencl.device import Device

    scene = quantized.dequantize()
    seen, scored, kind = _views(args, quantized, scene)
    device, settings = Device(args.device), BakeSettings(args.sh_degree, args.steps)
    with bar(count_steps(len(seen), settings), "baking") as advance:
        gaussians = bake(device, scene, seen, settings, on_step=advance)
    in_data_units = args.units == "data"
    if in_data_units:
        gaussians = to_world(gaussians, scene.transform)
    encoded = _encode(args.output, gaussians, kind)
    stored = encoded.gaussians
    if in_data_units:
        stored = to_scene(stored, scene.transform)
    return encoded, _summary(baked_loss(device, scene, stored, scored), len(encoded.data))


def _views(
    args: argparse.Namespace, quantized: QuantizedScene, scene: Scene
) -> tuple[list[BakeView], list[BakeView], str]:
    """Views to bake from, views to score, and the data set's kind, empty if there is none."""
    from clgs.bake.bake import BakeView, evenly
    from clgs.bake.cameras import cameras_around
    from clgs.cli.options.view import load_views

    if args.data is None:
        tell(
            "clgs: without --data cameras around the scene are assumed; with the data set it fits "
            "better"
        )
        around = [BakeView(camera) for camera in cameras_around(scene)]
        return around, evenly(around, SCORED_VIEWS), ""
    dataset: Dataset = load_views(args, quantized)
    train, test = (_with_photos(scene, views) for views in (dataset.train, dataset.test))
    return train, evenly(test or train, SCORED_VIEWS), dataset.kind


def _with_photos(scene: Scene, views: Sequence[View]) -> list[BakeView]:
    from clgs.bake.bake import BakeView

    def photo(view: View) -> Planes:
        view.photo.keep()
        return view.photo.planes(scene.settings.background, final=True)

    return [BakeView(view.camera, partial(photo, view)) for view in views]


def _encode(output: Path, gaussians: HostGaussians, kind: str = "") -> Encoded:
    """The file that ``output`` names by its suffix; ``kind`` of the data set, if known."""
    from clgs.data.axes import to_y_up
    from clgs.export.splats.glb import encode_glb
    from clgs.export.splats.ply import encode_ply
    from clgs.export.splats.sog import encode_sog
    from clgs.export.splats.spz import encode_spz

    suffix = output.suffix.lower()
    if suffix == ".glb":
        return encode_glb(gaussians, to_y_up(kind) if kind else None)
    return {".ply": encode_ply, ".spz": encode_spz, ".sog": encode_sog}[suffix](gaussians)


def _summary(cost: BakedLoss, size: int) -> str:
    """The line that says what baking costs."""
    megabytes = f"{size / 1e6:.1f} MB"
    if cost.scene is None:
        return f"baked: {cost.baked:.2f} dB against renders of the scene, {megabytes}"
    return (
        f"baked: {cost.baked - cost.scene:+.2f} dB, {megabytes} "
        f"({cost.baked:.2f} dB against the photos of {counted(cost.views, 'view')})"
    )
