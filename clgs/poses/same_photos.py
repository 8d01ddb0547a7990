"""Which photos of a data set are which files of a folder."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePath

from clgs.data.posed_photo import Photo
from clgs.poses.find import Found

REPORT = "report.json"
"""Names, for each photo of a data set that clgs prepare made, the file that it was made from."""


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
