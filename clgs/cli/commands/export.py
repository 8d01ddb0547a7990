"""``clgs export``: a scene or a data set in a file that other programs open."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    AS_TRAINED,
    add_device_name,
    add_masks,
    add_overwrite,
    add_size_options,
    chosen,
    named_path,
    whole_number,
)
from clgs.workflow.options import BAKE_STEPS, MOST_BAKE_STEPS, SH_DEGREES, UNITS, refuse

if TYPE_CHECKING:
    from clgs.workflow.export import ExportedCameras, ExportedGaussians, ExportedPage

DESCRIPTION = """\
Write what other programs open; the suffix of FILE says what:

  .glb   from SCENE: the same as glTF's KHR_gaussian_splatting, y up;
         from DATA: its points, if it has any, and the frustum of every camera,
         training cameras blue, held-out ones orange. Lengths are the world
         units of the data set; its up becomes glTF's y (Blender captures
         and transforms.json have z up, COLMAP models y down).
  .html  from SCENE: one web page that decodes and draws the scene, offline;
         with --viewer and no SCENE: a page to drop .clgs files on.
  .ply .spz .sog from SCENE: baked to ordinary 3D Gaussians, for 3DGS viewers.
         With --data they are fitted to its photos; without, to renders from
         cameras around the scene, which is worse. Splats (.ply, .spz, .sog,
         .splat) are converted. Coordinates are those of the data set."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.description = DESCRIPTION
    add = parser.add_argument
    add(
        "source",
        type=Path,
        nargs="?",
        metavar="SCENE|DATA",
        help="a run folder or .clgs file, or a data set, as FILE needs",
    )
    add("-o", "--output", type=named_path, required=True, metavar="FILE", help="new file")
    add(
        "--data",
        type=Path,
        help="the data set that SCENE was made of (default: the one that its run folder names)",
    )
    add_size_options(parser, "SCENE")
    add(
        "--sh-degree",
        type=whole_number(SH_DEGREES[-1], 0),
        choices=SH_DEGREES,
        help=f"degree of the colors' spherical harmonics, at most (default: {SH_DEGREES[-1]})",
    )
    add(
        "--steps",
        type=whole_number(MOST_BAKE_STEPS, 0),
        metavar="N",
        help=f"baking: steps of refinement after the fit; 0: none (default: {BAKE_STEPS})",
    )
    add(
        "--units",
        choices=UNITS,
        help="coordinates of the data set, or the scene's own (default: data)",
    )
    add(
        "--antialiased",
        action="store_const",
        const=True,
        help="baking: for viewers that draw antialiased splats, in which they look right from "
        "afar, too; the file asks for that",
    )
    add_masks(parser, AS_TRAINED)
    add_device_name(parser)
    add("--viewer", action="store_true", help=".html: a page without a scene, to drop files on")
    add("--name", metavar="TITLE", help=".html: title (default: the photos' folder)")
    add(
        "--link",
        metavar="ADDRESS",
        help=".html: read the .clgs file at ADDRESS, as seen from the page, instead of holding it; "
        "layers of `clgs encode --layers` are shown as they come",
    )
    add_overwrite(parser, "the file if it exists (default: refuse)")


def run(args: argparse.Namespace) -> int:
    """Write the file and print what it holds; exit code 0."""
    from clgs.cli.display import Display
    from clgs.errors import UsageError
    from clgs.workflow.export import export, export_link

    if args.viewer and args.source is not None:
        raise UsageError("--viewer makes a page without a scene; leave it out, or the SCENE")
    if not args.viewer and args.source is None and args.output.suffix.lower() == ".html":
        raise UsageError("name a SCENE, or give --viewer for a page without one")
    shared = chosen(vars(args), "data", "name", "overwrite")
    names = "sh_degree", "steps", "units", "downscale", "max_size", "device", "masks", "antialiased"
    others = chosen({"masks": None} | vars(args), *names)
    if args.link is not None:
        refuse(others, "has no effect with --link")
        show(export_link(args.source, args.output, args.link, **shared))
        return 0
    with Display() as display:
        made = export(args.source, args.output, on_event=display, **shared, **others)
    show(made)
    return 0


def show(made: ExportedPage | ExportedGaussians | ExportedCameras) -> None:
    """Print what was written, and what baking costs."""
    from clgs.cli.tell import counted
    from clgs.workflow.export import ExportedCameras, ExportedPage

    if isinstance(made, ExportedPage):
        scene = f", {made.scene_size:,} of them the scene" if made.scene_size else ""
        print(f"{made.path}: {made.size:,} bytes{scene}")
        return
    if isinstance(made, ExportedCameras):
        counts = f"{made.points:,} points, {made.cameras} cameras"
        print(f"{made.path}: {counts}, {made.size:,} bytes")
        return
    print(f"{made.path}: {made.gaussians:,} Gaussians, degree {made.degree}")
    megabytes, loss = f"{made.size / 1e6:.1f} MB", made.loss
    if loss is None:
        print(f"converted: {megabytes}")
    elif loss.scene is None:
        print(f"baked: {loss.baked:.2f} dB against renders of the scene, {megabytes}")
    else:
        print(
            f"baked: {loss.baked - loss.scene:+.2f} dB, {megabytes} "
            f"({loss.baked:.2f} dB against the photos of {counted(loss.views, 'view')})"
        )
