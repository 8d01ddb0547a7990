"""Raw photos or a video to a COLMAP data set with a verdict on every pose, and its files."""

from __future__ import annotations

import io
import json
import logging
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from PIL import Image

from clgs.arguments import as_path, check_range
from clgs.data.colmap_model import WORLD
from clgs.data.images import read_image
from clgs.errors import DataError, ExistsError, OutputError, is_full
from clgs.files import atomic_folder, check_folder
from clgs.poses.bring_in import LEAST_PHOTOS, bring_in, find_source
from clgs.poses.drop import drop_doubtful as drop_doubtful_photos
from clgs.poses.find import NAMED, REPORT, Collection, shown
from clgs.poses.known import Known, add_photos, read_known
from clgs.poses.pycolmap_child import SEEDS
from clgs.poses.reconstruct import reconstruct
from clgs.poses.unfinished import (
    Finished,
    digest_of,
    kept_pieces,
    owned,
    remove_leftovers,
    removed_if_killed,
)
from clgs.poses.verdict import PhotoVerdict, Verdict
from clgs.poses.workspace import OnProgress

_log = logging.getLogger(__name__)

CONTACT_SHEET = "contact_sheet.jpg"
"""All photos of the verdict, in its order; see :func:`contact_sheet`."""

COLUMNS = 8
CELL = (160, 120)
"""Width and height of a photo on the sheet, pixels."""

QUALITY = 80

MADE = {"images", "masks", "sparse", WORLD, REPORT, CONTACT_SHEET, "report.html"}
"""What this function, and the command of that name, make: a folder of these may be replaced."""


def prepare(
    photos: Path | str,
    output: Path | str,
    seed: int = 0,
    on_progress: OnProgress = lambda stage, done, total: None,
    overwrite: bool = False,
    quick: bool = False,
    frames: int | None = None,
    drop_doubtful: bool = False,
    max_size: int = 0,
    device: str | None = None,
    equirectangular: bool = False,
    poses: Path | str | None = None,
    continued: Path | str | None = None,
) -> Verdict:
    """Find camera poses and points of the photos in and below ``photos``, or of a video.

    ``output`` gets images/ (undistorted), masks/ if photos are masked, sparse/0/ (binary, pinhole
    cameras), report.json with the verdict that is returned, contact_sheet.jpg, and world.txt if
    ``poses`` or GPS tags tell scale or place; it appears complete or not at all. A warning names
    the files that are skipped. Until then a hidden folder next to it keeps what is finished: if the
    process is killed, the same call goes on from there, to the same result, and a warning says so.

    Args:
        photos: the folder, or a video.
        output: new folder, or an empty one.
        seed: of all random choices; the same seed gives the same poses.
        on_progress: called with a stage of ``clgs.poses.workspace.STAGES``, the finished amount,
            and the total.
        overwrite: ``output`` may replace what an earlier call made.
        quick: half the features, one mapper, and no second reconstruction that tests the poses.
        frames: number of frames to take from a video; default 100.
        drop_doubtful: leave out the photos whose poses are in doubt.
        max_size: photos that are wider are reduced to about this width once their poses are found;
            0: they keep their size.
        device: which compares features; number or part of the name.
        equirectangular: all photos, or the video, show the whole sphere, and are cut into pinhole
            views; photos whose XMP data say so are in any case.
        poses: a data set of any program, or one of its files, that has poses of some of the photos:
            they are refined by the matches instead of found again, unless matches contradict them.
        continued: a data set to which the photos are added: its photos and poses come along.

    Raises:
        DataError: too few or damaged photos, no reconstruction, no pycolmap; or too few photos
            would be left without those in doubt.
        DeviceError: there is no such device.
        OutputError: ``output`` is not empty, or cannot be made.
        OSError: the disk is full, or another fault of ``output``.
    """
    check_range("seed", seed, 0)
    check_range("max_size", max_size, 0)
    check_range("frames", 1 if frames is None else frames, 1)
    least = LEAST_PHOTOS if continued is None else 1
    source = find_source(as_path("photos", photos), frames, least)
    output = as_path("output", output)
    known = Known()
    if poses is not None or continued is not None:
        if source.collection is None:
            raise DataError(f"{photos}: is a video, which has no given poses; name photos")
        if continued is not None:
            add_photos(as_path("continued", continued), source.collection)
        given = as_path("poses", poses if poses is not None else continued)
        known = read_known(given, source.collection)
    expected = source.frames or len(source.files)
    try:
        check_folder(output.parent)
        output.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(output)
        if overwrite:
            _check_replaceable(output, source.files)
        options = seed % SEEDS, quick, equirectangular, known.plain(), continued is not None
        kept_for = digest_of(source.files + source.masks, [source.frames, *options])
        with (
            kept_pieces(output, kept_for) as kept,
            atomic_folder(output, overwrite) as target,
        ):
            work = target / "work"
            with owned(work), removed_if_killed(target, kept):
                finished = kept or work / "finished"
                finished.mkdir(exist_ok=True)
                if line := Finished(finished).summary():
                    _log.warning("%s: goes on where an earlier call was stopped: %s", output, line)
                on_progress("read", 0, expected)
                bring_in(source, work, lambda n: on_progress("read", n, expected), equirectangular)
                verdict = reconstruct(
                    *(target, seed % SEEDS, quick, max_size, device, on_progress),
                    *(known, continued is not None, finished),
                )
                if drop_doubtful:
                    verdict = drop_doubtful_photos(target, verdict)
                verdict = _with_sources(verdict, source.collection)
                names = [work / "images" / one.name for one in verdict.photos]
                sheet = contact_sheet(names, lambda done: on_progress("report", done, len(names)))
                (target / CONTACT_SHEET).write_bytes(sheet)
                report = json.dumps(asdict(verdict), indent=1, allow_nan=False)
                (target / REPORT).write_text(report + "\n", encoding="utf-8")
            shutil.rmtree(work)
            return verdict
    except OutputError:
        raise
    except OSError as error:
        if is_full(error):  # the error of a copy names the photo, which is not at fault
            raise OSError(error.errno, error.strerror, str(output)) from error
        problem = error.strerror or str(error)
        raise DataError(f"{error.filename or output}: {problem}") from error


def _with_sources(verdict: Verdict, found: Collection | None) -> Verdict:
    """Say in a verdict what photos were called, and in a note that some have other names now."""
    below = {Path(one.name).stem: one.below for one in found.photos} if found else {}
    photos = list[PhotoVerdict]()
    for one in verdict.photos:
        source = below.get(Path(one.name).stem, one.name)
        photos.append(one if source == one.name else replace(one, source=source))
    renamed = [
        f"{shown(one.source)} is {shown(one.name)}"
        for one in photos
        if one.source and Path(one.source).with_suffix("") != Path(one.name).with_suffix("")
    ]
    notes = verdict.notes
    if renamed:
        plural = "photos have other names" if len(renamed) > 1 else "photo has another name"
        more = ", ..." * (len(renamed) > NAMED)
        notes += (f"{len(renamed)} {plural} in the data set: {', '.join(renamed[:NAMED])}{more}",)
    return replace(verdict, photos=tuple(photos), notes=notes)


def _check_replaceable(output: Path, photos: list[Path]) -> None:
    """Raise OutputError unless ``output`` is free, or an earlier result without these photos."""
    if not output.is_dir() or not any(output.iterdir()):
        return
    if not (output / "sparse" / "0" / "cameras.bin").is_file():
        raise ExistsError(f"{output}: was not made by clgs prepare; remove it or choose another")
    others = sorted({path.name for path in output.iterdir()} - MADE)
    if others:
        raise ExistsError(
            f"{output / others[0]}: was not made by clgs prepare; move it, or choose another folder"
        )
    if any(output.resolve() in path.resolve().parents for path in photos):
        raise ExistsError(f"{output}: holds the photos that are read; choose another")


def contact_sheet(
    photos: Sequence[Path], on_photo: Callable[[int], None] = lambda done: None
) -> bytes:
    """Make a JPEG file: COLUMNS photos per row, each reduced to fit into the middle of its CELL.

    ``on_photo`` receives the number of photos that are done.

    Raises:
        DataError: a photo is damaged.
    """
    width, height = CELL
    rows = -(-len(photos) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, max(rows, 1) * height), (128, 128, 128))
    for number, path in enumerate(photos):
        picture = Image.fromarray(read_image(path).color)
        picture.thumbnail(CELL)
        row, column = divmod(number, COLUMNS)
        left = column * width + (width - picture.width) // 2
        sheet.paste(picture, (left, row * height + (height - picture.height) // 2))
        on_photo(number + 1)
    buffer = io.BytesIO()
    sheet.save(buffer, "JPEG", quality=QUALITY)
    return buffer.getvalue()
