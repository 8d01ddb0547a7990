"""Matches of features between photos, verified by a two-view geometry."""

from __future__ import annotations

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from clgs.poses.job import THREADS, Job
from clgs.poses.match_part import Pairs, match_part
from clgs.poses.pairs import MAX_EXHAUSTIVE, all_pairs, likely_pairs

TILE, GROUP = 12, 144
"""GROUP pairs are matched at a time, of two runs of TILE photos: few have to be indexed anew."""

MOST_PROCESSES = 8
"""Each has a copy of the database, 1 MB or more per photo."""

LOOSE_RATIO = 0.9
"""Of the best over the second best distance, at the second look; COLMAP's default is 0.8."""

MAX_SECOND_LOOK = 20
"""So many photos that were left out are matched with all others."""


def match(job: Job) -> int:
    """Match all pairs that may have something in common; returns how many were tried."""
    pairs = _choose(job)
    _match(job, "matches", pairs)
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
    _match(job, "second look", pairs, LOOSE_RATIO)


def _choose(job: Job) -> list[tuple[int, int]]:
    count = len(job.names)
    if count <= MAX_EXHAUSTIVE:
        return all_pairs(count)
    with job.open() as database:
        descriptors = [database.read_descriptors(number).data for number in job.ids(database)]
    return likely_pairs(descriptors, job.seed)


def _match(job: Job, stage: str, pairs: list[tuple[int, int]], ratio: float | None = None) -> None:
    """Match and verify ``pairs`` of places in ``job.names``, a part of them in each process."""
    ordered = sorted(pairs, key=lambda pair: (pair[0] // TILE, pair[1] // TILE, pair))
    parts = _parts([(job.names[i], job.names[j]) for i, j in ordered])
    matched, one_at_a_time = 0, threading.Lock()

    def tell(more: int) -> None:
        nonlocal matched
        with one_at_a_time:
            matched += more
            job.on_progress(stage, matched, len(pairs))

    tell(0)
    own = [replace(job, folder=job.folder / f"matching_{number}") for number in range(len(parts))]
    with ThreadPoolExecutor(max(1, len(parts))) as pool:
        for one in own:
            one.folder.mkdir()
            shutil.copyfile(job.database, one.database)
        running = [
            pool.submit(match_part, one, groups, ratio, tell)
            for one, groups in zip(own, parts, strict=True)
        ]
        for future in running:
            future.result()
    for one, groups in zip(own, parts, strict=True):
        _take(job, one, [pair for group in groups for pair in group])
        shutil.rmtree(one.folder)


def _parts(pairs: Pairs) -> list[list[Pairs]]:
    """The groups of pairs that each process matches."""
    processes = min(THREADS, MOST_PROCESSES)
    size = max(1, min(GROUP, -(-len(pairs) // processes)))
    groups = [pairs[start : start + size] for start in range(0, len(pairs), size)]
    return [part for k in range(processes) if (part := groups[k::processes])]


def _take(job: Job, part: Job, pairs: Pairs) -> None:
    """Write what the process of ``part`` found into the database of ``job``."""
    with job.open() as whole, part.open() as found:
        ids = dict(zip(job.names, job.ids(whole), strict=True))
        for first, second in ((ids[a], ids[b]) for a, b in pairs):
            whole.write_matches(first, second, found.read_matches(first, second))
            geometry = found.read_two_view_geometry(first, second)
            whole.write_two_view_geometry(first, second, geometry)
