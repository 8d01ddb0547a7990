"""The second reconstruction, from half of the points, which tests the first one."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import Event
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.machine import available_memory
from clgs.poses.evidence import (
    MAX_CONTRADICTED,
    MIN_MATCHES,
    Evidence,
    ModelChoice,
)
from clgs.poses.pycolmap_child import CrashError
from clgs.poses.stages.mapping import (
    MANY,
    STRONG,
    best_model,
    largest_models,
    map_by,
    map_strongest,
    mappers,
    replace_doubtful,
)
from clgs.poses.stages.matching import read_evidence
from clgs.poses.workspace import THREADS, Workspace

HALF = 0.5
"""Share of all tracks from which the second reconstruction is made."""

OTHER_SEED = 1_000_003
"""Added to the seed: the second reconstruction must not follow the first one's choices."""

STAGE = "check"

PHOTO_MEMORY = 16 << 20
"""Bytes that must be available per photo if two mappers are to run at once."""


class _CancelledError(Exception):
    pass


class SecondReconstruction:
    """A second reconstruction from half of the points, by the mapper of the kept model.

    What both reconstructions agree on can be trusted. A photo whose pose rests on little, or on
    matches that contradict each other, comes to stand elsewhere. The first reconstruction plays no
    part, so that the second one may be made at the same time, on another core.
    """

    def __init__(self) -> None:
        """Begin nothing yet."""
        self._pool = ThreadPoolExecutor(1)  # mappers let Python's other threads go on
        self._begun, self._cancelled, self._awaited = 0, Event(), Event()
        self._evidence: Evidence | None = None
        self._mapper = ""
        self._half: Workspace | None = None
        self._made: Future[ModelChoice | None] = Future()

    def __enter__(self) -> SecondReconstruction:
        """Do nothing: the check is a context, so that no thread is left behind."""
        return self

    def __exit__(self, *error: object) -> None:
        """Stop what is being made."""
        self._cancelled.set()
        self._pool.shutdown()

    def begin_early(self, workspace: Workspace, evidence: Evidence) -> None:
        """Begin by the first mapper, if a core is free for it, and memory for both mappers.

        What was begun with other evidence is given up.
        """
        if THREADS > 1 and fit_together(len(workspace.names)) and evidence.pairs:
            self._begin(workspace, evidence, mappers(workspace)[0])

    def give_up(self) -> bool:
        """Stop what is being made, whose memory is needed; returns whether there was anything."""
        begun, self._evidence = self._evidence is not None, None
        self._cancelled.set()
        if begun:
            self._made.exception()  # wait for its end
        return begun

    def model(self, workspace: Workspace, choice: ModelChoice) -> Any | None:
        """Wait for the second reconstruction of this choice, pycolmap's; None if there is none.

        If it crashed next to the first one, perhaps for want of memory, it is made once more.
        """
        early = self._evidence is choice.evidence and self._mapper == choice.kept.mapper
        if not early or isinstance(self._wait(workspace), CrashError):
            self._begin(workspace, choice.evidence, choice.kept.mapper)
            self._wait(workspace)
        made = self._made.result()
        return made and made.kept.reconstruction

    def _wait(self, workspace: Workspace) -> BaseException | None:
        self._awaited.set()
        workspace.on_progress(STAGE, 0, 0)
        return self._made.exception()

    def replace_doubtful(self, doubtful: Sequence[str]) -> Any | None:
        """Place photos again in the last :meth:`model`, by its own half of the points alone."""
        made = self._made.result()
        if made is None or self._half is None:
            return None
        return replace_doubtful(self._half, made, doubtful, STAGE).kept.reconstruction

    def _begin(self, workspace: Workspace, evidence: Evidence, mapper: str) -> None:
        self._cancelled.set()
        self._begun += 1
        self._cancelled, self._awaited = cancelled, awaited = Event(), Event()
        self._evidence, self._mapper = evidence, mapper

        def on_progress(stage: str, done: int, total: int) -> None:
            if cancelled.is_set():
                raise _CancelledError
            if awaited.is_set():
                workspace.on_progress(stage, done, total)

        kept = workspace.finished and workspace.finished.part(f"{STAGE} {self._begun}")
        self._half = half = replace(
            workspace,
            folder=workspace.folder / STAGE,
            seed=(workspace.seed + OTHER_SEED) % 2**31,
            on_progress=on_progress,
            finished=kept,
        )
        self._made = self._pool.submit(_map_half, workspace, half, evidence, mapper)


def _map_half(
    whole: Workspace, half: Workspace, evidence: Evidence, mapper: str
) -> ModelChoice | None:
    """Make a model from half of the tracks of ``whole``; returns None if there is none."""
    shutil.rmtree(half.folder, ignore_errors=True)  # of what was given up
    half.folder.mkdir()
    half.pycolmap.set_random_seed(half.seed)  # each thread has its own
    _write_half(whole, half, evidence)
    part = read_evidence(half)
    found = {} if mapper == STRONG else {mapper: map_by(mapper, half, STAGE)}
    models = largest_models(found, part)
    if not models or models[0].explained.contradicted > MAX_CONTRADICTED:
        found[STRONG] = map_strongest(half, part, STAGE)
        models = largest_models(found, part)
    return ModelChoice(best_model(models), models, part, []) if models else None


def _write_half(whole: Workspace, half: Workspace, evidence: Evidence) -> None:
    """Write the database of ``half``: all features, and the matches whose track is drawn.

    The half is drawn by tracks, so that none is split.
    """
    rng = np.random.default_rng(half.seed)
    tracks = tracks_of(evidence)
    count = 1 + max((int(one.max(initial=0)) for one in tracks.values()), default=0)
    drawn = rng.random(count) < HALF
    shutil.copyfile(whole.database, half.database)
    with whole.open() as every, half.open() as part:
        part.clear_descriptors()
        part.clear_matches()
        part.clear_two_view_geometries()
        for pair in evidence.pairs:
            kept = pair.matches[drawn[tracks[pair.first][pair.matches[:, 0]]]]
            if len(kept) >= MIN_MATCHES:
                geometry = every.read_two_view_geometry(pair.first, pair.second)
                geometry.inlier_matches = kept
                part.write_matches(pair.first, pair.second, kept)
                part.write_two_view_geometry(pair.first, pair.second, geometry)


def tracks_of(evidence: Evidence) -> dict[int, npt.NDArray[np.int64]]:
    """Number the things that features show: (K,) per image, by the image's number.

    Matches join features, those of the best matched pairs first. A match is ignored if it would
    join two features of the same photo: among repeated things most features would be one otherwise.
    """
    numbers = sorted(evidence.keypoints)
    counts = [len(evidence.keypoints[number]) for number in numbers]
    start = dict(zip(numbers, np.cumsum([0, *counts])[:-1].tolist(), strict=True))
    parent = list(range(sum(counts)))
    photos = [1 << place for place, count in enumerate(counts) for _ in range(count)]

    def root(feature: int) -> int:
        while parent[feature] != feature:
            parent[feature] = feature = parent[parent[feature]]
        return feature

    for pair in sorted(evidence.pairs, key=lambda pair: -len(pair.matches)):
        for left, right in np.add(pair.matches, (start[pair.first], start[pair.second])).tolist():
            one, other = root(left), root(right)
            if one != other and not photos[one] & photos[other]:
                parent[other] = one
                photos[one] |= photos[other]
    track = np.array([root(feature) for feature in range(len(parent))], np.int64)
    return {
        number: track[start[number] : start[number] + count]
        for number, count in zip(numbers, counts, strict=True)
    }


def fit_together(photos: int) -> bool:
    """Whether two mappers of that many photos fit into the memory that is free.

    If the system does not say, MANY photos do.
    """
    available = available_memory()
    return photos <= MANY if available is None else photos * PHOTO_MEMORY <= available
