"""Examines a data set: finds all faults at once, while the loader stops at the first.

Photo files may be damaged, copied, of several sizes, of changing exposure, masked.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clgs.data.complaints import NONE_LEFT
from clgs.data.dataset import is_posed, read_photo_set
from clgs.data.images import check_chunks, exif_turn, open_image
from clgs.data.masks import read_mask
from clgs.data.origin import read_origin
from clgs.data.points import read_points
from clgs.data.posed_photo import Photo, PhotoFolder, PhotoSet, locate
from clgs.data.reduction import MAX_SIZE
from clgs.data.transforms import (
    BLENDER,
    BLENDER_TEST,
    TRANSFORMS,
    count_frames,
    read_frame,
    read_json,
)
from clgs.doctor import ERROR, NOTE, WARNING, Finding, errors_first, from_error, named
from clgs.doctor.cameras import check_lenses, check_poses
from clgs.errors import DataError
from clgs.files import in_any_case
from clgs.poses.find import find_photos

SMALL_SIDE = 64
"""Pixels; smaller photos show little to learn from."""

JUMP = 0.6
"""Stops between neighbours; a larger jump is reported if it is rare."""

RARE = 6.0
"""A jump is this many times as large as the median difference of neighbours."""

_THUMBNAIL = 64


@dataclass(frozen=True)
class _Looked:
    """digest of the file; brightness: mean level in (0, 1]; used: share that a mask leaves.

    exif: whether the file has an EXIF orientation, and whether the pixels are turned by it;
    mask_exif: the same of its mask.
    """

    digest: bytes
    brightness: float
    used: float = 1.0
    exif: tuple[bool, bool] = (False, False)
    mask_exif: tuple[bool, bool] = (False, False)


def check_pictures(photos: list[Photo], rendered: bool) -> Iterator[Finding]:
    """Findings of all files; every photo is decoded, small where its format allows.

    Args:
        photos: in the order of the data set.
        rendered: no camera took them, so that their brightness says nothing.
    """
    counts = Counter((photo.lens.width, photo.lens.height) for photo in photos)
    if len(counts) > 1:
        text = ", ".join(f"{n} of {w}x{h}" for (w, h), n in counts.most_common(4))
        more = ", ..." * (len(counts) > 4)
        yield Finding(NOTE, "", f"photos have several sizes: {text}{more}", "nothing to do")
    widest = max(width for width, _ in counts)
    if widest > MAX_SIZE:
        problem = f"photos are up to {widest} pixels wide, and reduced to {MAX_SIZE}"
        yield Finding(NOTE, "", problem, "--max-size 0 keeps their size; --downscale is faster")
    tiny = [photo.name for photo in photos if min(photo.lens.width, photo.lens.height) < SMALL_SIDE]
    if tiny:
        problem = f"a side is shorter than {SMALL_SIDE} pixels"
        yield Finding(WARNING, named(tiny), problem, "use the photos as they were taken")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        looked = list(pool.map(_look, photos))
    whole = []
    for photo, found in zip(photos, looked, strict=True):
        if isinstance(found, DataError):
            fault = from_error(found)
            yield Finding(ERROR, photo.name, fault.problem, fault.remedy)
        else:
            whole.append((photo.name, found))
    yield from _copies(whole)
    if used := [one.used for _, one in whole if one.used < 1.0]:
        problem = f"{len(used)} photos are masked; {np.mean(used):.0%} of their pixels are used"
        yield Finding(NOTE, "", problem, "nothing to do: what is masked is neither used nor scored")
    yield from _orientations(whole)
    if not rendered:
        yield from _exposure(sorted(whole))


def damaged(paths: list[Path]) -> list[DataError]:
    """What is wrong with each file that cannot be read as a picture; every one is decoded."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        looked = pool.map(_look_at, paths)
        return [found for found in looked if isinstance(found, DataError)]


def _look(photo: Photo) -> _Looked | DataError:
    """The look at a photo and its mask, or what is wrong with either."""
    found = _look_at(photo.path)
    if isinstance(found, DataError):
        return found
    size = photo.lens.width, photo.lens.height
    try:
        found = replace(found, exif=exif_turn(photo.path, size))
        if photo.mask is None:
            return found
        used = float(read_mask(photo.mask, size).mean())
        return replace(found, used=used, mask_exif=exif_turn(photo.mask, size))
    except DataError as error:
        return error


def _look_at(path: Path) -> _Looked | DataError:
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "blake2b").digest()
        check_chunks(path)
        with open_image(path) as picture:
            if picture.mode == "RGB":
                picture.draft("RGB", (_THUMBNAIL, _THUMBNAIL))
            picture.load()
            deep = picture.mode.startswith("I")
            small = picture.resize((_THUMBNAIL, _THUMBNAIL), reducing_gap=2.0)
            levels = np.asarray(small if deep else small.convert("RGBA"), np.float64)
    except OSError as error:
        return DataError(f"{path}: {error.strerror or error}; replace it")
    except DataError as error:
        return error
    if deep:
        return _Looked(digest, max(float(levels.mean()) / 65535, 1e-3))
    weight = np.maximum(levels[..., 3], 1e-9)
    brightness = float((levels[..., :3].mean(axis=2) * weight).sum() / weight.sum()) / 255
    return _Looked(digest, max(brightness, 1e-3))


def _copies(whole: list[tuple[str, _Looked]]) -> Iterator[Finding]:
    by_digest: dict[bytes, list[str]] = {}
    for name, looked in whole:
        by_digest.setdefault(looked.digest, []).append(name)
    for names in by_digest.values():
        if len(names) > 1:
            problem = f"{len(names)} files hold the same bytes"
            remedy = "keep one: a held-out photo that is trained on scores too well"
            yield Finding(WARNING, named(names), problem, remedy)


def _orientations(whole: list[tuple[str, _Looked]]) -> Iterator[Finding]:
    for what, tags in (
        ("photos", [(name, looked.exif) for name, looked in whole]),
        ("masks", [(name, looked.mask_exif) for name, looked in whole]),
    ):
        for turned, done in ((False, "taken as stored"), (True, "turned to fit their poses")):
            if names := [name for name, tag in tags if tag == (True, turned)]:
                problem = f"{len(names)} {what} have an EXIF orientation; their pixels are {done}"
                remedy = "if renders lie on the side, prepare again"
                yield Finding(NOTE, named(names), problem, remedy)


def _exposure(whole: list[tuple[str, _Looked]]) -> Iterator[Finding]:
    """Jumps of brightness between photos that are neighbours by name."""
    if len(whole) < 4:
        return
    stops = np.abs(np.diff(np.log2([looked.brightness for _, looked in whole])))
    limit = max(JUMP, RARE * float(np.median(stops)))
    jumps = [
        f"{whole[i][0]} to {whole[i + 1][0]} ({stops[i]:.1f} stops)"
        for i in np.flatnonzero(stops > limit)
    ]
    if jumps:
        remedy = "clgs train --exposure learns it; better, fix exposure and white balance"
        yield Finding(WARNING, named(jumps), "brightness jumps between neighbours", remedy)


FILES = BLENDER, BLENDER_TEST, TRANSFORMS

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
            document = read_json(file, lenient=True)
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
                if (finding := from_error(error)) not in findings:  # of a field that frames share
                    findings.append(finding)
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
    points = photos.points
    if photos.points_file is not None:
        try:
            points = read_points(photos.points_file, FEW_POINTS, photos.kind, seed=0)
        except DataError as error:
            yield from_error(error)
    if points is not None and len(points) < FEW_POINTS:
        problem = f"only {len(points)} points to start from"
        remedy = "prepare again, or give --points FILE"
        yield Finding(WARNING, str(photos.points_file or ""), problem, remedy)
    if models := photos.models_in_words():
        remedy = "if photos are missing, take more between the parts and prepare again"
        yield Finding(NOTE, "", models, remedy)
