"""Examines a data set: finds all faults at once, while the loader stops at the first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from clgs.data.complaints import NONE_LEFT
from clgs.data.dataset import is_posed, read_photo_set
from clgs.data.locate import PhotoFolder, locate
from clgs.data.origin import read_origin
from clgs.data.points import read_points
from clgs.data.posed_photo import Photo, PhotoSet
from clgs.data.transforms import count_frames, read_document, read_frame
from clgs.doctor.cameras import check_lenses, check_poses
from clgs.doctor.finding import ERROR, NOTE, WARNING, Finding, errors_first, from_error, named
from clgs.doctor.pictures import check_pictures, damaged
from clgs.errors import DataError
from clgs.files import in_any_case
from clgs.poses.find import find_photos

FILES = ("transforms_train.json", "transforms_test.json", "transforms.json")

FEW_POINTS = 100
"""Training starts badly from fewer."""


@dataclass(frozen=True)
class Examined:
    """A line on what the folder holds, and all findings, errors first."""

    summary: str
    findings: list[Finding]


def examine(root: Path) -> Examined:
    """All findings of the data set in ``root``; its photos are decoded.

    Raises:
        DataError: there is no data set, and no photos either.
    """
    findings: list[Finding] = []
    try:
        photos = read_photo_set(root)
    except DataError as error:
        if not is_posed(root) and not in_any_case(root / FILES[1]).is_file():
            return _unposed(root, error)
        photos, found = _piecewise(root)
        findings += found or [from_error(error)]
    everyone = photos.train + photos.test
    findings += _missing(root, photos)
    if len(photos.test) > 1 and not photos.train:
        findings.append(Finding(ERROR, "", *NONE_LEFT.split("; ")))
    if everyone:
        findings += check_lenses(everyone)
        findings += check_poses(everyone)
        findings += check_pictures(everyone, photos.kind == "blender")
    if photos.stray_masks:
        problem = f"{len(photos.stray_masks)} files look like masks, but are those of no photo"
        remedy = "call them NAME.png as the photos are, in masks; they are not used"
        findings.append(Finding(WARNING, named(photos.stray_masks), problem, remedy))
    findings += _points(photos)
    split = f"{len(photos.train)} to train on, {len(photos.test)} held out"
    summary = f"{photos.kind}, {len(everyone)} photos ({split})"
    if not everyone:
        summary = "no photo can be used"
    return Examined(f"{root}: {summary}", errors_first(findings))


def _unposed(root: Path, error: DataError) -> Examined:
    """Photos without poses: what ``clgs prepare`` would make of them."""
    if not root.is_dir():
        raise error
    if (root / "plan.json").is_file() and (root / "data").is_dir():
        raise DataError(f"{root}: was made by clgs run; name {root / 'data'}, what it trained on")
    if origin := read_origin(root):
        raise DataError(f"{root}: is a run; name what it was trained on: {origin.folder}")
    found = find_photos(root)
    if not found.photos:
        raise error
    bad = damaged([photo.path for photo in found.photos])
    findings = [from_error(error), *map(from_error, bad)]
    for line in found.lines():
        text = line.removeprefix(f"{found.root}: ")
        findings.append(Finding(NOTE, "", text, "nothing to do, if these are no photos of it"))
    return Examined(f"{root}: {len(found.photos) - len(bad)} photos without poses", findings)


def _piecewise(root: Path) -> tuple[PhotoSet, list[Finding]]:
    """Each frame of the transforms files by itself; nothing of a COLMAP model."""
    photos: dict[str, Photo] = {}
    missing: list[str] = []
    findings: list[Finding] = []
    kind = "blender" if in_any_case(root / FILES[0]).is_file() else "transforms"
    for file in filter(Path.is_file, (in_any_case(root / name) for name in FILES)):
        try:
            document = read_document(file, lenient=True)
            count = count_frames(file, document)
        except DataError as error:
            findings.append(from_error(error))
            continue
        files = PhotoFolder(root)
        for number in range(count):
            try:
                listed = read_frame(file, document, number)
                photo = locate(listed, root, files)
            except DataError as error:
                findings.append(from_error(error))
                continue
            if photo is None:
                missing.append(listed.name)
            elif photo.name in photos and kind == "transforms":
                problem = f"{photo.name!r} is listed twice"
                findings.append(Finding(ERROR, listed.source, problem, "keep one of the two"))
            else:
                photos[photo.name] = photo
    return PhotoSet(kind, list(photos.values()), [], missing), findings


def _missing(root: Path, photos: PhotoSet) -> Iterator[Finding]:
    if photos.missing:
        total = len(photos.missing) + len(photos.train) + len(photos.test)
        problem = f"{len(photos.missing)} of {total} photos are missing"
        remedy = "restore them; training leaves them out"
        # files whose names differ from a missing one in capitals or suffix only
        near = []
        for name in photos.missing:
            for base in (root, root / "images"):
                wanted = base / name
                if (
                    wanted.is_relative_to(root)
                    and ".." not in wanted.parts
                    and wanted.parent.is_dir()
                ):
                    stem = wanted.stem.lower()
                    near += [p.name for p in wanted.parent.iterdir() if p.stem.lower() == stem]
        if near:
            remedy = f"rename {near[0]} and its like; names must agree in capitals and suffix"
        yield Finding(WARNING, named(photos.missing), problem, remedy)


def _points(photos: PhotoSet) -> Iterator[Finding]:
    if photos.points is not None and len(photos.points) < FEW_POINTS:
        problem = f"only {len(photos.points)} points to start from"
        yield Finding(WARNING, "", problem, "prepare again, or give --points FILE")
    if photos.points_file is not None:
        try:
            read_points(photos.points_file, FEW_POINTS, photos.kind, seed=0)
        except DataError as error:
            yield from_error(error)
    if models := photos.models_in_words():
        remedy = "if photos are missing, take more between the parts and prepare again"
        yield Finding(NOTE, "", models, remedy)
