"""A scene or a data set in a file that other programs open; its suffix says which."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from clgs.arguments import as_path, check_choice, check_range, check_type
from clgs.codec import scene_decoder, splat_packing
from clgs.codec.scene_encoder import encode
from clgs.data.dataset import load_dataset
from clgs.data.origin import repose
from clgs.data.posed_photo import to_y_up
from clgs.data.splats.integer_splats import read_splats
from clgs.data.view import Planes, View
from clgs.errors import DataError, UsageError
from clgs.exports.glb import cameras_glb, encode_glb
from clgs.exports.page import scene_page, start_at
from clgs.exports.splats.ply import Encoded, encode_ply, file_units
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz, fraction_bits
from clgs.files import atomic_write, check_output
from clgs.opencl.device import Device
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import IDENTITY, QuantizedScene, SceneTransform, SplatScene
from clgs.scene.world import EARTH, in_words
from clgs.workflow.bake import (
    BakedLoss,
    BakeSettings,
    BakeView,
    bake,
    baked_loss,
    cameras_around,
    count_steps,
    evenly,
)
from clgs.workflow.events import Note, OnEvent, counter, ignore
from clgs.workflow.options import (
    BAKE_STEPS,
    MOST_BAKE_STEPS,
    SH_DEGREES,
    UNITS,
    ViewOptions,
    refuse,
)
from clgs.workflow.outputs import check_new
from clgs.workflow.scenes import (
    SPLAT_SUFFIXES,
    instead,
    naming,
    read_bytes,
    read_drawable,
    run_folder,
)
from clgs.workflow.views import check_photo_options, known_data, load_views, scene_name

PHOTO_OPTIONS = ("downscale", "max_size", "masks", "device")

SUFFIXES = (".glb", ".html", ".ply", ".spz", ".sog")

LOSSY = 0.25
"""Splats that move by this share of their size are worth a note."""

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


class Baking(TypedDict, total=False):
    """How a scene is baked, as arguments of :func:`export`; None as if it were not given."""

    steps: int | None
    downscale: int | None
    max_size: int | None
    masks: str | None
    antialiased: bool | None
    device: str | None


def export(
    source: Path | str | None,
    output: Path | str,
    *,
    data: Path | str | None = None,
    sh_degree: int | None = None,
    units: str | None = None,
    name: str | None = None,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
    **baking: Unpack[Baking],
) -> ExportedPage | ExportedGaussians | ExportedCameras:
    """Write a scene or a data set as a file for other programs; the suffix says which.

    ``.html`` is a web page that draws the scene. ``.ply``, ``.spz``, ``.sog`` and ``.glb`` are
    ordinary Gaussians, to which a trained scene is baked. ``.glb`` of a data set holds its points
    and cameras. An argument that the file does not depend on is refused.

    Args:
        source: run folder, .clgs file, file of splats (.ply, .spz, .sog, .splat), or folder of a
            data set; None for a page without a scene, to drop files on.
        output: the new file.
        data: the data set of the scene; default: the one that its run folder names. Gaussians are
            fitted to its photos, the page starts at its first held-out view, and the y axis of a
            .glb is its up.
        sh_degree: highest degree of the colors' spherical harmonics, 0 to 3; default: 3.
        units: of the Gaussians, "data" (the data set's coordinates, the default) or "scene".
        name: title of a page; default: that of the photos' folder, or of ``source``.
        overwrite: whether ``output`` may be replaced.
        on_event: receives progress and notes.
        baking: of a trained scene. steps: of refinement after the fit; default: BAKE_STEPS.
            downscale: the photos are reduced this many times. max_size: wider photos are reduced
            to this width in pixels. masks: what they mean, "ignore" or "object"; default: as in
            training. antialiased: whether the Gaussians are for viewers that draw such ones, which
            .ply, .spz and .sog ask for. device: number or part of the name.

    Raises:
        UsageError: the suffix is unknown, ``source`` is not what it needs, or an argument has no
            use.
        ExistsError: ``output`` exists, and ``overwrite`` is false.
        DataError: ``source`` or the data set is missing or damaged.
    """
    source = None if source is None else as_path("source", source)
    output = as_path("output", output)
    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise UsageError(f"{output}: nothing is written by this suffix; take one of {known}")
    check_new(output, overwrite)
    photos = None if data is None else as_path("data", data)
    given: dict[str, Any] = {**baking}
    check_range("sh_degree", sh_degree or 0, SH_DEGREES[0], SH_DEGREES[-1])
    check_range("steps", given.get("steps") or 0, 0, MOST_BAKE_STEPS)
    check_choice("units", units or UNITS[0], UNITS)
    check_type("name", name or "", str, "the title of the page")
    drawn = {"sh_degree": sh_degree, "units": units}
    if suffix == ".html":
        refuse(drawn | given, "a page holds the scene as it is; leave it out")
        return _page(source, output, photos, name, None)
    refuse({"name": name}, "only a page has a title; leave it out")
    if suffix == ".glb" and not (
        source and (source.is_file() or (run_folder(source) / "scene.npz").exists())
    ):
        if source is None:
            raise UsageError("a data set is needed: `clgs export DATA -o cameras.glb`")
        refuse(drawn | given | {"data": data}, f"{source} is a data set; leave it out")
        dataset = load_dataset(source, load_images=False)
        glb = cameras_glb(dataset)
        atomic_write(output, glb)
        cameras = len(dataset.train) + len(dataset.test)
        return ExportedCameras(output, len(glb), len(dataset.points), cameras)
    if source is None:
        raise UsageError(f"a scene is needed: `clgs export SCENE -o {output.name}`")
    check_output(output, source)
    scene, _ = read_drawable(source)
    transform = scene.transform if units != "scene" else IDENTITY
    degree = SH_DEGREES[-1] if sh_degree is None else sh_degree
    kind, loss = "", None
    if isinstance(scene, SplatScene):
        refuse(given, "splats are converted, not baked; leave it out")
        if suffix != ".glb":
            refuse({"data": data}, "only .glb has an up, which a data set tells; leave it out")
        if photos is not None:
            kind = load_dataset(photos, load_images=False).kind
        sh = scene.gaussians.sh[:, : (degree + 1) ** 2]
        gaussians = replace(scene.gaussians, sh=np.ascontiguousarray(sh))
        up = to_y_up(kind, scene.transform.frame) if kind else None
        _check_coordinates(output, gaussians.mean, transform)
        encoded = _encode(output, gaussians, transform, up, on_event)
    else:
        steps, antialiased = given.pop("steps", None), given.pop("antialiased", None)
        photo_options = {name: given.pop(name, None) for name in PHOTO_OPTIONS}
        refuse(given, "there is no such option; leave it out")
        views = ViewOptions(photos or known_data(source), **photo_options)
        check_photo_options(views)
        settings = BakeSettings(degree, BAKE_STEPS if steps is None else steps, bool(antialiased))
        encoded, loss = _bake(source, output, scene, views, settings, transform, on_event)
    atomic_write(output, encoded.data)
    made = encoded.gaussians
    return ExportedGaussians(output, len(encoded.data), len(made), made.degree, loss)


def _bake(
    source: Path,
    output: Path,
    quantized: QuantizedScene,
    views: ViewOptions,
    settings: BakeSettings,
    transform: SceneTransform,
    on_event: OnEvent,
) -> tuple[Encoded, BakedLoss]:
    """The file of the baked Gaussians, and what baking costs."""
    scene, kind = quantized.dequantize(), ""
    _check_coordinates(output, scene.anchors.position, transform)  # before baking

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
            [BakeView(view.camera, partial(photo, view), view.used) for view in views]
            for views in (dataset.train, dataset.test)
        )
        scored, kind = evenly(held_out or seen, SCORED_VIEWS), dataset.kind
    device = Device(views.device)
    advance = counter("baking", count_steps(len(seen), settings), on_event)
    gaussians = bake(device, scene, seen, settings, on_step=advance)
    up = to_y_up(kind, scene.transform.frame) if kind else None
    encoded = _encode(output, gaussians, transform, up, on_event)
    return encoded, baked_loss(device, scene, encoded.gaussians, scored)


def _check_coordinates(
    output: Path, position: npt.NDArray[np.float32], transform: SceneTransform
) -> None:
    """Raise DataError if positions (N, 3) are too large for the kind of file."""
    try:
        if output.suffix.lower() == ".spz":
            fraction_bits(transform.to_world(position.astype(np.float64)))
    except DataError as error:
        raise DataError(f"{output}: {error}") from None


def _encode(
    output: Path,
    gaussians: HostGaussians,
    transform: SceneTransform,
    up: npt.NDArray[np.float64] | None,
    on_event: OnEvent,
) -> Encoded:
    """The file that ``output`` names by its suffix; ``up``: turns y up (3, 3), None if not known.

    A :class:`Note` tells what the format, or programs that read it, cannot hold.
    """
    suffix = output.suffix.lower()
    if suffix == ".glb":
        encoded = encode_glb(gaussians, transform, up)
        if gaussians.antialiased:
            text = (
                "has no mark for antialiased splats, other programs draw them too bright from afar"
            )
            on_event(Note(f"{output}: .glb {text}; .ply, .spz and .sog have one"))
        return encoded
    encode = {".ply": encode_ply, ".spz": encode_spz, ".sog": encode_sog}[suffix]
    encoded = encode(gaussians, transform)
    if suffix == ".spz" and transform.frame == EARTH:
        where = in_words(transform.frame, transform.place)
        on_event(Note(f"{output}: .spz does not hold where its origin is: {where}"))
    apart = np.abs(encoded.gaussians.mean - gaussians.mean).max(axis=1)
    moved, size = float(np.median(apart)), float(np.exp(np.median(gaussians.log_scale)))
    remedy = "--units scene puts their middle at the origin, and .glb keeps both"
    if transform == IDENTITY:
        remedy = "distant ones make the file coarse: leave them out, or write .ply"
    if moved > LOSSY * size:
        times = f"{moved / size:.2g} times the size of a splat"
        on_event(Note(f"{output}: splats are moved by {times}, half of them further; {remedy}"))
    elif file_units(gaussians, transform)[2].any():
        text = "many programs compute in float32, too coarse so far from the origin"
        on_event(Note(f"{output}: {text}; {remedy}"))
    return encoded


def export_link(
    source: Path | str | None,
    output: Path | str,
    link: str,
    *,
    data: Path | str | None = None,
    name: str | None = None,
    overwrite: bool = False,
) -> ExportedPage:
    """Write the web page of a scene that it does not hold, but reads when it is opened.

    Args:
        source: run folder, .clgs file or file of splats, which gives title and first view; None for
            a page that guesses a view.
        output: the new .html file.
        link: the address of the .clgs file, as seen from the page; if it is in layers, they are
            shown as they come.
        data: the data set of the scene; default: the one that its run folder names.
        name: title of the page; default: that of the photos' folder, or of ``source``.
        overwrite: whether ``output`` may be replaced.

    Raises:
        UsageError: ``output`` is no .html file, or ``link`` nothing that it can read.
        ExistsError: ``output`` exists, and ``overwrite`` is false.
        DataError: ``source`` or the data set is missing or damaged.
    """
    output = as_path("output", output)
    if output.suffix.lower() != ".html":
        raise UsageError(f"{output}: only a page has a link to its scene; name an .html file")
    if not link:
        raise UsageError("link: is empty; name the .clgs file as seen from the page")
    scheme, colon, _ = link.partition("/")[0].partition(":")
    if "\\" in link or (colon and scheme.lower() not in ("http", "https")):
        remedy = "give http(s)://..., or the way there from the page, with /"
        raise UsageError(f"link: a page cannot read {link}; {remedy}")
    check_new(output, overwrite)
    return _page(
        None if source is None else as_path("source", source),
        output,
        None if data is None else as_path("data", data),
        name,
        link,
    )


def _page(
    source: Path | None, output: Path, photos: Path | None, name: str | None, link: str | None
) -> ExportedPage:
    """Write the web page of a scene, which holds it or names its address, or one without a scene.

    It starts at the first held-out view of the data set ``photos``, if there is one.
    """
    data, start = b"", None
    if source is not None:
        photos = photos or known_data(source)
        data = _scene_file(source)
        check_output(output, source)
    if photos is not None and source is not None:
        transform = IDENTITY  # splats keep the data set's units
        if not splat_packing.is_splats(data):
            transform = SceneTransform(**scene_decoder.describe(data)["transform"])
        views = repose(load_dataset(photos, load_images=False), transform)
        first = (views.test or views.train)[0]
        start = start_at(first.camera, [view.camera for view in views.train])
    named = scene_name(photos) if photos and source else source.stem if source else ""
    held = data if link is None else b""
    page = scene_page(held, name or named, start, link)
    atomic_write(output, page)
    return ExportedPage(output, len(page), len(held))


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
    elif path.suffix.lower() in SPLAT_SUFFIXES:
        return splat_packing.pack(read_splats(path, {})[0])
    data = read_bytes(path)
    with naming(path):
        reader = splat_packing if splat_packing.is_splats(data) else scene_decoder
        found = reader.describe(data)
        if "layers" in found:  # a page holds a file as a whole: layers would only cost bytes
            return encode(scene_decoder.decode(data), found["level"])
    return data
