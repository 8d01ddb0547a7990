"""A scene or a data set in a file that other programs open; its suffix says which."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from clgs.bake.bake import (
    BakedLoss,
    BakeSettings,
    BakeView,
    bake,
    baked_loss,
    count_steps,
    evenly,
    to_scene,
    to_world,
)
from clgs.bake.cameras import cameras_around
from clgs.codec import scene_decoder, splat_packing
from clgs.data.dataset import load_dataset
from clgs.data.origin import repose
from clgs.data.posed_photo import to_y_up
from clgs.data.stored_photo import Planes
from clgs.data.view import View
from clgs.errors import DataError, UsageError
from clgs.exports.cameras import cameras_glb
from clgs.exports.page import scene_page, start_at
from clgs.exports.splats.encoded import Encoded
from clgs.exports.splats.glb import encode_glb
from clgs.exports.splats.ply import encode_ply
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz
from clgs.files import atomic_write, check_output
from clgs.opencl.device import Device
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import QuantizedScene, SceneTransform, SplatScene
from clgs.workflow.events import Note, OnEvent, counter, ignore
from clgs.workflow.options import BAKE_STEPS, SH_DEGREES, ViewOptions
from clgs.workflow.outputs import check_new
from clgs.workflow.scenes import instead, naming, read_bytes, read_drawable, run_folder
from clgs.workflow.views import known_data, load_views, scene_name

SUFFIXES = (".glb", ".html", ".ply", ".spz", ".sog")

SCORED_VIEWS = 32
"""The most views, evenly chosen, that measure what baking costs."""


@dataclass(frozen=True)
class ExportedPage:
    """A web page of ``size`` bytes, of which ``scene_size`` are the scene; 0 without a scene."""

    path: Path
    size: int
    scene_size: int


@dataclass(frozen=True)
class ExportedGaussians:
    """A file of ordinary Gaussians: bytes, number, degree of their colors, and the loss of baking.

    loss: None if the scene was one of ordinary Gaussians.
    """

    path: Path
    size: int
    gaussians: int
    degree: int
    loss: BakedLoss | None


@dataclass(frozen=True)
class ExportedCameras:
    """A glTF file of a data set: its bytes, points and cameras."""

    path: Path
    size: int
    points: int
    cameras: int


def export(
    source: Path | str | None,
    output: Path | str,
    *,
    data: Path | str | None = None,
    sh_degree: int = SH_DEGREES[-1],
    steps: int = BAKE_STEPS,
    units: str = "data",
    downscale: int | None = None,
    max_size: int | None = None,
    device: str | None = None,
    name: str | None = None,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> ExportedPage | ExportedGaussians | ExportedCameras:
    """Write a scene or a data set as a file for other programs; the suffix says which.

    ``.html`` is a web page that draws the scene. ``.ply``, ``.spz``, ``.sog`` and ``.glb`` are
    ordinary Gaussians, to which a trained scene is baked. ``.glb`` of a data set holds its points
    and cameras.

    Args:
        source: run folder, .clgs file, 3DGS .ply file, or folder of a data set; None for a page
            without a scene, to drop files on.
        output: the new file.
        data: the data set of the scene; default: the one that its run folder names. Gaussians are
            fitted to its photos, and the page starts at its first held-out view.
        sh_degree: highest degree of the colors' spherical harmonics, 0 to 3.
        steps: of refinement after the fit.
        units: of the Gaussians, "data" (the data set's coordinates) or "scene".
        downscale: the photos are reduced this many times.
        max_size: wider photos are reduced to this width in pixels.
        device: number or part of the name.
        name: title of a page; default: that of the photos' folder, or of ``source``.
        overwrite: whether ``output`` may be replaced.
        on_event: receives progress and notes.

    Raises:
        UsageError: the suffix is unknown, or ``source`` is not what it needs.
        ExistsError: ``output`` exists, and ``overwrite`` is false.
        DataError: ``source`` or the data set is missing or damaged.
    """
    source = None if source is None else Path(source)
    output = Path(output)
    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise UsageError(f"{output}: nothing is written by this suffix; take one of {known}")
    check_new(output, overwrite)
    photos = None if data is None else Path(data)
    if photos is None and source is not None:
        photos = known_data(source)
    if suffix == ".html":
        return _page(source, output, photos, name)
    if suffix == ".glb" and not (
        source and (source.is_file() or (run_folder(source) / "scene.npz").exists())
    ):
        if source is None:
            raise UsageError("a data set is needed: `clgs export DATA -o cameras.glb`")
        dataset = load_dataset(source, load_images=False)
        glb = cameras_glb(dataset)
        atomic_write(output, glb)
        cameras = len(dataset.train) + len(dataset.test)
        return ExportedCameras(output, len(glb), len(dataset.points), cameras)
    if source is None:
        raise UsageError(f"a scene is needed: `clgs export SCENE -o {output.name}`")
    check_output(output, source)
    scene, _ = read_drawable(source)
    loss = None
    if isinstance(scene, SplatScene):
        gaussians = scene.gaussians
        kept = replace(gaussians, sh=gaussians.sh[:, : (sh_degree + 1) ** 2])
        encoded = _encode(output, kept, "")
    else:
        views = ViewOptions(photos, downscale=downscale, max_size=max_size, device=device)
        settings = BakeSettings(sh_degree, steps)
        encoded, loss = _bake(source, output, scene, views, settings, units == "data", on_event)
    atomic_write(output, encoded.data)
    made = encoded.gaussians
    return ExportedGaussians(output, len(encoded.data), len(made), made.degree, loss)


def _bake(
    source: Path,
    output: Path,
    quantized: QuantizedScene,
    views: ViewOptions,
    settings: BakeSettings,
    in_data_units: bool,
    on_event: OnEvent,
) -> tuple[Encoded, BakedLoss]:
    """The file of the baked Gaussians, and what baking costs."""
    scene, kind = quantized.dequantize(), ""

    def photo(view: View) -> Planes:
        view.photo.keep()
        return view.photo.planes(scene.settings.background, final=True)

    if views.data is None:
        assumed = "without --data cameras around the scene are assumed"
        on_event(Note(f"{assumed}; with the data set it fits better"))
        seen = [BakeView(camera) for camera in cameras_around(scene)]
        scored = evenly(seen, SCORED_VIEWS)
    else:
        dataset = load_views(source, quantized, views, on_event)
        seen, held_out = (
            [BakeView(view.camera, partial(photo, view)) for view in views]
            for views in (dataset.train, dataset.test)
        )
        scored, kind = evenly(held_out or seen, SCORED_VIEWS), dataset.kind
    device = Device(views.device)
    advance = counter("baking", count_steps(len(seen), settings), on_event)
    gaussians = bake(device, scene, seen, settings, on_step=advance)
    if in_data_units:
        gaussians = to_world(gaussians, scene.transform)
    encoded = _encode(output, gaussians, kind)
    stored = encoded.gaussians
    if in_data_units:
        stored = to_scene(stored, scene.transform)
    return encoded, baked_loss(device, scene, stored, scored)


def _encode(output: Path, gaussians: HostGaussians, kind: str) -> Encoded:
    """The file that ``output`` names by its suffix; ``kind`` of the data set, "" if not known."""
    suffix = output.suffix.lower()
    if suffix == ".glb":
        return encode_glb(gaussians, to_y_up(kind) if kind else None)
    return {".ply": encode_ply, ".spz": encode_spz, ".sog": encode_sog}[suffix](gaussians)


def _page(source: Path | None, output: Path, photos: Path | None, name: str | None) -> ExportedPage:
    """Write the web page of a scene, or one without a scene.

    It starts at the first held-out view of the data set ``photos``, if there is one.
    """
    data, start = b"", None
    if source is not None:
        data = _scene_file(source)
        check_output(output, source)
    if photos is not None and source is not None:
        transform = SceneTransform()  # splats keep the data set's units
        if not splat_packing.is_splats(data):
            transform = SceneTransform(**scene_decoder.describe(data)["transform"])
        views = repose(load_dataset(photos, load_images=False), transform)
        first = (views.test or views.train)[0]
        start = start_at(first.camera, [view.camera for view in views.train])
    named = scene_name(photos) if photos and source else source.stem if source else ""
    page = scene_page(data, name or named, start)
    atomic_write(output, page)
    return ExportedPage(output, len(page), len(data))


def _scene_file(path: Path) -> bytes:
    """The bytes of a .clgs file, or of the one in a run folder, once its container is checked.

    Raises:
        DataError: there is none, or it is damaged.
    """
    if path.is_dir():
        file = run_folder(path) / "scene.clgs"
        if not file.exists():
            raise DataError(f"{path}: is a folder without scene.clgs; {instead(path)}")
        path = file
    elif path.suffix.lower() == ".ply":
        raise DataError(f"{path}: a page is made of a .clgs file; `clgs pack` makes one of splats")
    data = read_bytes(path)
    with naming(path):
        (splat_packing if splat_packing.is_splats(data) else scene_decoder).describe(data)
    return data
