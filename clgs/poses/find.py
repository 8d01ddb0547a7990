"""The photos in a folder and below it, with their masks, and which of them a data set has."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from clgs.data.images import HEIF_SUFFIXES, SUFFIXES
from clgs.data.masks import MASK_FOLDERS, find_mask, list_masks
from clgs.data.posed_photo import Photo
from clgs.errors import DataError

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".mts", ".3gp")
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
UNREAD_SUFFIXES = (".tif", ".tiff", ".bmp", ".gif", ".avif", ".jxl", *RAW_SUFFIXES)

NAME_LENGTH = 120
"""Characters that the name in the data set keeps of a photo's own name, from its end."""

NAMED = 5
"""Files that are named of those that are skipped for one reason."""

REPORT = "report.json"
"""Names, for each photo of a data set that clgs prepare made, the file that it was made from."""

_FOREIGN_FOLDERS = (*MASK_FOLDERS, "__MACOSX", "@eaDir")
_RUNS = ("plan.json", "progress.csv")
"""A folder that holds one of these was made by clgs run or train."""

_OWN = (*_RUNS, "sparse/0/cameras.bin")
"""A folder below that holds one of these was made by clgs run, train or prepare."""

_UNSAFE = re.compile(r"[^\w.+=@()\[\] -]|[\ud800-\udfff]")


@dataclass(frozen=True)
class Found:
    """A photo: its file, its name in the data set to be made, the file of its mask if any.

    below: the path below the folder of photos that it comes from.
    """

    path: Path
    name: str
    below: str
    mask: Path | None = None


@dataclass
class Collection:
    """The photos below ``root`` in order; skipped: (name below it, reason) of all other files."""

    root: Path
    photos: list[Found] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)

    def skip(self, path: Path, reason: str) -> None:
        """Note why a file or folder is no photo."""
        self.skipped.append((path.relative_to(self.root).as_posix(), reason))

    def lines(self) -> list[str]:
        """One line for each reason that files were skipped for, with the first of their names."""
        reasons: dict[str, list[str]] = {}
        for name, reason in self.skipped:
            reasons.setdefault(reason, []).append(shown(name))
        return [
            f"{self.root}: skipped {len(names)}, {reason}: {', '.join(names[:NAMED])}"
            + ", ..." * (len(names) > NAMED)
            for reason, names in reasons.items()
        ]


def shown(name: str) -> str:
    """The end of a file's name, as it can be printed."""
    return name[-80:] if name.isprintable() else repr(name[-80:])


def is_video(path: Path) -> bool:
    """Whether ``path`` is a file that is named as a video."""
    return path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES


def find_photos(folder: Path) -> Collection:
    """Photos in ``folder``, else in its images/, and in all folders below; nothing is decoded.

    Hidden files, files of other kinds, empty ones and second copies of the same bits are skipped.

    Raises:
        DataError: ``folder`` is none, or that of a run.
    """
    if folder.is_file():
        photo = _is_photo(folder)
        remedy = (
            f"({folder.parent})" if photo else "or a video (.mp4, .mov, .mkv, .webm and others)"
        )
        raise DataError(f"{folder}: is a file; name the folder of the photos {remedy}")
    if not folder.is_dir():
        raise DataError(f"{folder}: no such file or folder; name photos or a video")
    if any((folder / file).is_file() for file in _RUNS):
        raise DataError(f"{folder}: was made by clgs; name the folder of your own photos")
    images = folder / "images"
    made = any((folder / file).exists() for file in _OWN)  # and its contact sheet is no photo
    own = not made and any(_is_photo(path) for path in folder.iterdir())
    collection = Collection(images if images.is_dir() and not own else folder)
    files = {path: path.relative_to(collection.root).as_posix() for path in _files(collection)}
    masks = {path: find_mask(folder, collection.root, below) for path, below in files.items()}
    photos = [path for path in files if path not in set(masks.values())]
    kept, names, taken = _without_copies(photos, collection), dict[Path, str](), set[str]()
    for path in sorted(kept, key=lambda path: files[path] != _plain(files[path])):
        names[path] = new_name(files[path], taken)  # first those that can keep theirs
    collection.photos = [Found(path, names[path], files[path], masks[path]) for path in kept]
    used = {path for found in collection.photos for path in (found.path, found.mask)}
    collection.skipped += [
        (path.relative_to(folder).as_posix(), "masks of no photo")
        for path in list_masks(folder, collection.root)
        if path not in used
    ]
    return collection


def _is_photo(path: Path) -> bool:
    known = path.suffix.lower() in SUFFIXES + HEIF_SUFFIXES
    return known and not path.name.startswith(".") and path.is_file()


def _files(collection: Collection) -> Iterator[Path]:
    """Files that are photos by their names; the others, and some folders, are noted as skipped."""
    for where, folders, names in os.walk(collection.root):
        here = Path(where)
        searched = []
        for name in sorted(folders):
            path = here / name
            if path.is_symlink() and name not in _FOREIGN_FOLDERS:
                collection.skip(path, "links to folders; copy what they hold")
            elif any((path / file).exists() for file in _OWN):
                collection.skip(path, "folders that clgs made")
            elif name not in _FOREIGN_FOLDERS and not name.startswith("."):
                searched.append(name)
        folders[:] = searched
        for name in sorted(names):
            if reason := _reason(here / name):
                collection.skip(here / name, reason)
            else:
                yield here / name


def _reason(path: Path) -> str:
    """Why a file is skipped; empty if it is a photo by its name."""
    suffix = path.suffix.lower()
    if path.name.startswith("."):
        return "hidden files"
    if suffix in UNREAD_SUFFIXES:
        return "of formats that are not read; convert them to JPEG or PNG"
    if suffix in VIDEO_SUFFIXES:
        return "videos; give each to clgs prepare by itself"
    if suffix not in SUFFIXES + HEIF_SUFFIXES:
        return "no photos"
    if not path.exists():
        return "broken links"
    if not path.is_file():
        return "no regular files"
    return "" if path.stat().st_size else "empty files"


def _without_copies(paths: list[Path], collection: Collection) -> list[Path]:
    """``paths`` without files that hold the same bytes as an earlier one."""
    sizes = Counter(path.stat().st_size for path in paths)
    seen: set[bytes] = set()
    kept = []
    for path in paths:
        if sizes[path.stat().st_size] > 1:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "blake2b").digest()
            if digest in seen:
                collection.skip(path, "second copies of the same bytes")
                continue
            seen.add(digest)
        kept.append(path)
    return kept


def new_name(below: str, taken: set[str]) -> str:
    """A name for the data set, without folders, that no other photo has; suffix as it was.

    ``below``: the path below the folder of photos; ``taken``: lower stems, to which it is added.
    """
    plain = _plain(below)
    stem, dot, suffix = plain.rpartition(".")
    number, name = 1, plain
    while name.rpartition(".")[0].lower() in taken:
        number += 1
        name = f"{stem}-{number}{dot}{suffix}"
    taken.add(name.rpartition(".")[0].lower())
    return name


def _plain(below: str) -> str:
    """The part of a name that the data set keeps."""
    return _UNSAFE.sub("_", below.replace("/", "_"))[-NAME_LENGTH:].lstrip(". ") or "photo.jpg"


def read_sources(data: Path) -> dict[str, str]:
    """Read what the photos of a data set were called in the folder that it was made from.

    Returns:
        The path below that folder, by the stem of the name in the data set, of photos with another
        name there; empty if clgs prepare did not make the data set.
    """
    try:
        photos = json.loads((data / REPORT).read_text(encoding="utf-8"))["photos"]
        named = {Path(one["name"]).stem: one.get("source", "") for one in photos}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}
    return {stem: path for stem, path in named.items() if path and isinstance(path, str)}


def match_photos(
    found: Sequence[Found], posed: Sequence[Photo], sources: Mapping[str, str]
) -> tuple[dict[int, int], list[int]]:
    """Match the photos of a data set with files.

    A photo is the same file. Else its name without suffix is the file's, and so are more of the
    folders above it than of any other such file; if two agree in as many, the suffix decides.

    Args:
        found: the files.
        posed: the photos of the data set.
        sources: as of :func:`read_sources`.

    Returns:
        The number of a file by that of its photo; and the numbers of photos that may be several
        files.
    """
    by_path = {one.path.resolve(): number for number, one in enumerate(found)}
    same = {
        number: by_path[path]
        for number, photo in enumerate(posed)
        if (path := photo.path.resolve()) in by_path
    }
    files = _by_stem((n, one.path) for n, one in enumerate(found) if n not in set(same.values()))
    origins = [PurePath(sources.get(photo.path.stem, photo.path)) for photo in posed]
    photos = _by_stem((n, path) for n, path in enumerate(origins) if n not in same)
    unsure = list[int]()
    for stem, numbers in photos.items():
        alike = {
            (photo, file): _alike(origins[photo], found[file].path)
            for photo in numbers
            for file in files.get(stem, ())
        }
        for photo in numbers if alike else ():
            file = _best({other: alike[photo, other] for other in files[stem]})
            if file is not None and _best({n: alike[n, file] for n in numbers}) == photo:
                same[photo] = file
            elif file is None:
                unsure.append(photo)
    return same, unsure


def stem_of(path: PurePath) -> str:
    """The name without folder, suffix and case."""
    return path.stem.casefold()


def _by_stem(paths: Iterable[tuple[int, PurePath]]) -> dict[str, list[int]]:
    numbers = defaultdict[str, list[int]](list)
    for number, path in paths:
        numbers[stem_of(path)].append(number)
    return numbers


def _alike(first: PurePath, second: PurePath) -> tuple[int, bool]:
    """How many folders right above two files are called the same, and whether the suffixes are."""
    count = 0
    for one, other in zip(first.parts[-2::-1], second.parts[-2::-1], strict=False):
        if one.casefold() != other.casefold():
            break
        count += 1
    return count, first.suffix.casefold() == second.suffix.casefold()


def _best(alike: Mapping[int, tuple[int, bool]]) -> int | None:
    """The number with the largest value; None if several have it."""
    most = max(alike.values())
    best = [number for number, value in alike.items() if value == most]
    return best[0] if len(best) == 1 else None
