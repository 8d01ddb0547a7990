"""Matches of features between photos, verified by a two-view geometry."""

from __future__ import annotations

from typing import Any

from clgs.data.sfm.job import THREADS, Job
from clgs.data.sfm.pairs import MAX_EXHAUSTIVE, all_pairs, likely_pairs

TILE, GROUP = 12, 144
"""GROUP pairs are matched at a time, of two runs of TILE photos: few have to be indexed anew."""

LOOSE_RATIO = 0.9
"""Of the best over the second best distance, at the second look; COLMAP's default is 0.8."""

MAX_SECOND_LOOK = 20
"""So many photos that were left out are matched with all others."""


def match(job: Job) -> int:
    """Match all pairs that may have something in common; returns how many were tried."""
    pairs = _choose(job)
    _match(job, "matches", pairs, _matching_options(job))
    return len(pairs)


def match_again(job: Job, left_out: list[int]) -> None:
    """Match photos, by their place in ``job.names``, with all others, less strictly."""
    left_out = left_out[:MAX_SECOND_LOOK]
    chosen = set(left_out)
    pairs = [(i, j) for i, j in all_pairs(len(job.names)) if i in chosen or j in chosen]
    with job.open() as database:
        ids = job.ids(database)
        for first, second in ((ids[i], ids[j]) for i, j in pairs):
            if database.exists_matches(first, second):
                database.delete_matches(first, second)
            if database.exists_two_view_geometry(first, second):
                database.delete_two_view_geometry(first, second)
    options = _matching_options(job)
    options.sift.max_ratio = LOOSE_RATIO
    _match(job, "second look", pairs, options)


def _choose(job: Job) -> list[tuple[int, int]]:
    count = len(job.names)
    if count <= MAX_EXHAUSTIVE:
        return all_pairs(count)
    with job.open() as database:
        descriptors = [database.read_descriptors(number).data for number in job.ids(database)]
    return likely_pairs(descriptors, job.seed)


def _matching_options(job: Job) -> Any:
    options = job.pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = THREADS
    return options


def _match(job: Job, stage: str, pairs: list[tuple[int, int]], options: Any) -> None:
    """Match and verify ``pairs`` of places in ``job.names``, a group after the other.

    Progress is told in between. To look into the database meanwhile is no way: Python's SQLite in
    the process of pycolmap's drops that one's locks.
    """
    ordered = sorted(pairs, key=lambda pair: (pair[0] // TILE, pair[1] // TILE, pair))
    for start in range(0, len(ordered), GROUP):
        job.on_progress(stage, start, len(ordered))
        _match_group(job, ordered[start : start + GROUP], options)
    job.on_progress(stage, len(ordered), len(ordered))


def _match_group(job: Job, pairs: list[tuple[int, int]], options: Any) -> None:
    listed = job.folder / "pairs.txt"
    listed.write_text("".join(f"{job.names[i]} {job.names[j]}\n" for i, j in pairs))
    pairing = job.pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    verification = job.pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job.seed
    job.call(
        job.pycolmap.match_image_pairs,
        job.database,
        matching_options=options,
        pairing_options=pairing,
        verification_options=verification,
        device=job.pycolmap.Device.cpu,
    )
