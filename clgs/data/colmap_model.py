"""COLMAP models (sparse/0, binary or text, with or without rigs) to posed photos and points."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from clgs.data.colmap_files import LEAST_IMAGE_BYTES, read_binary, read_text
from clgs.data.colmap_records import ColmapCamera, ColmapModel
from clgs.data.images import list_images
from clgs.data.lens import Lens
from clgs.data.posed_photo import ListedPhoto, PhotoSet, hold_out, locate_all, rigid
from clgs.errors import DataError
from clgs.files import in_any_case
from clgs.scene.world import from_text

NOT_UNDISTORTED = ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE")
"""Camera models whose distortion is not removed here."""


WORLD = "world.txt"
"""What the world of a data set is, in a line as of ``clgs.scene.world``; next to its folder sparse.
"""

MAX_WORLD_BYTES = 4096

DISTORTED, DISTORTED_PHOTOS = "distorted", "input"
"""Where 3DGS's convert.py keeps the model and the photos that it undistorts."""

WORKSPACES = "", "dense", "dense/[0-9]*", "[0-9]*", "colmap", DISTORTED
"""Folders below a data set that may hold models: in sparse/0, sparse/1 and so on, in sparse, or in
themselves, next to their photos. Models of the first that has any are read.
"""

MODELS = "sparse", "colmap"
"""What the names of folders begin with in which, two levels deep, models are looked for if no
workspace has one: Sparse/0, sparse/aligned, colmap_text.
"""

PHOTOS = "image", "input", "photo", "rgb"
"""What the names of folders of photos begin with, such as images_4."""


def find_model(root: Path) -> Path | None:
    """The folder at or below ``root`` that holds the COLMAP model with the most photos."""
    return next(iter(find_models(root)), None)


def find_models(root: Path) -> dict[Path, int]:
    """The folders of the models of one workspace and their numbers of photos, largest first."""
    for workspace in WORKSPACES:
        found: list[Path] = []
        bases = [root / workspace]
        if workspace.endswith("*"):
            bases = sorted(path for path in root.glob(workspace) if path.name.isdecimal())
        for base in bases:
            numbered = (p for p in (base / "sparse").glob("[0-9]*") if p.name.isdecimal())
            found += sorted(numbered, key=lambda path: int(path.name))
            found.append(base / "sparse")
            if (base / "images").is_dir() or (_suffix(base) and list_images(base)):
                found.append(base)
        models = [folder for folder in found if _suffix(folder)]
        if models:
            counts = {folder: _count_photos(folder) for folder in models}
            return dict(sorted(counts.items(), key=lambda one: -one[1]))
    tops = [path for path in _folders(root) if path.name.casefold().startswith(MODELS)]
    below = (path for top in tops for pattern in ("*", "*/*") for path in sorted(top.glob(pattern)))
    counts = {path: _count_photos(path) for path in (root, *tops, *below) if _is_whole(path)}
    return dict(sorted(counts.items(), key=lambda one: -one[1]))


def _folders(root: Path) -> list[Path]:
    return sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []


def _suffix(folder: Path) -> str:
    """The suffix of the files of a model, binary or else text; empty if there is none."""
    forms = (s for s in (".bin", ".txt") if in_any_case(folder / f"cameras{s}").is_file())
    return next(forms, "")


def _is_whole(folder: Path) -> bool:
    files = "cameras", "images", "points3D"
    forms = ([folder / (file + suffix) for file in files] for suffix in (".bin", ".txt"))
    return any(all(in_any_case(file).is_file() for file in form) for form in forms)


def _count_photos(folder: Path) -> int:
    """The number of photos that the model in ``folder`` declares, at most what its file can hold.

    Nothing else of the model is read; 0 if there is no such file.
    """
    binary, text = in_any_case(folder / "images.bin"), in_any_case(folder / "images.txt")
    if binary.is_file():
        with binary.open("rb") as file:
            declared = int.from_bytes(file.read(8), "little")
        return min(declared, binary.stat().st_size // LEAST_IMAGE_BYTES)
    if not text.is_file():
        return 0
    with text.open("rb") as file:
        return (sum(not line.startswith(b"#") for line in file) + 1) // 2


def read_model(folder: Path) -> ColmapModel:
    """The model in a folder, binary if there is a cameras.bin, else text.

    Raises:
        DataError: names file, place and remedy.
    """
    suffix = _suffix(folder) or ".txt"
    for name in ("cameras", "images", "points3D"):
        file = folder / f"{name}{suffix}"
        if not in_any_case(file).is_file():
            raise DataError(f"{file}: missing; export the model again")
    return read_binary(folder) if suffix == ".bin" else read_text(folder)


def read_colmap(root: Path, folder: Path) -> PhotoSet:
    """Photos of ``root``/images posed by the model in ``folder``, with masks.

    Photos without a folder images lie next to the model or in a folder above it, up to ``root``.
    Every 8th photo by name is held out; points that are not finite are left out.

    Raises:
        DataError: names file, field and remedy.
    """
    model = read_model(folder)
    file = in_any_case(folder / f"images{_suffix(folder)}")
    listed = []
    for image in model.images:
        source = f"{file}: image {image.name[:80]!r}"
        camera = image.camera
        listed.append(
            ListedPhoto(
                image.name,
                source,
                rigid(image.rotation(), f"{source}: rotation"),
                np.array(image.translation),
                (camera.width, camera.height),
                partial(_lens, camera, source),
            )
        )
    photos, missing = locate_all(listed, root, _photo_folder(root, folder, model), str(folder))
    usable = np.all(np.abs(model.position) < 1e12, axis=1)
    found = PhotoSet(
        "colmap", *hold_out(photos), missing, model.position[usable], model.color[usable]
    )
    if (root / WORLD).is_file():
        with (root / WORLD).open("rb") as opened:
            text = opened.read(MAX_WORLD_BYTES).decode("utf-8", errors="replace")
        found.frame, found.place = from_text(text.splitlines())
    if folder != root and len(models := find_models(root)) > 1:
        found.models = {path.relative_to(root).as_posix(): n for path, n in models.items()}
    return found


def _photo_folder(root: Path, folder: Path, model: ColmapModel) -> Path:
    """The folder that names of a model are relative to: the first that has any of its photos."""
    names = [image.name for image in model.images if not Path(image.name).is_absolute()]
    images = root / "images"
    raw = root / DISTORTED_PHOTOS
    if folder.is_relative_to(root / DISTORTED) and any((raw / name).is_file() for name in names):
        return raw  # images has undistorted photos of the same names
    for above in (folder, *folder.parents):
        named = (path for path in _folders(above) if path.name.casefold().startswith(PHOTOS))
        for place in (above / "images", above, *named):
            if any((place / name).is_file() for name in names):
                return place
        if above == root:
            break
    return images if images.is_dir() else root


def _lens(camera: ColmapCamera, source: str, width: int, height: int) -> Lens:
    if camera.model in NOT_UNDISTORTED:
        raise DataError(
            f"{source}: camera model {camera.model} cannot be undistorted here; run COLMAP's "
            "image_undistorter first"
        )
    values = camera.values()
    fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    return Lens.of_model(
        camera.model, (width, height), (fx, fy), (values["cx"], values["cy"]), values
    )
