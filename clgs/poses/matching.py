"""SIFT features of photos, and matches between them, verified by a two-view geometry.

On several threads pycolmap 4.2.1 now and then loses most matches of a pair: of 719 in photos of a
can 42 were left. It seems that threads in OpenBLAS spoil each other's products. So several child
processes match, each on one thread and in its own copy of the database.
"""

from __future__ import annotations

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clgs.poses.child import OnStage, run_child
from clgs.poses.judging.evidence import MIN_MATCHES, Evidence, MatchedPair
from clgs.poses.pairs import all_pairs
from clgs.poses.pycolmap_lazy import quiet_pycolmap
from clgs.poses.workspace import THREADS, Workspace

MAX_FEATURES = 8192
"""The most features of a photo; COLMAP's default. pycolmap prefers large ones."""

QUICK_FEATURES = 4096

FINEST_SIZE = 3200
"""Larger photos are reduced to this longer side before the search, pixels; COLMAP's default."""

DOUBLED_SIZE = 1600
"""Photos up to this size are searched at twice their resolution, too, as COLMAP does by default.

Doubled images beyond FINEST_SIZE would take gigabytes of memory.
"""

PEAK_THRESHOLD = 0.004
"""The least contrast of a feature; COLMAP's 0.0067 finds too few in small photos."""

BATCH = 4 * THREADS
"""Photos between two reports of progress."""

TILE, GROUP = 12, 144
"""GROUP pairs are matched at a time, of two runs of TILE photos, so that few are indexed twice."""

MOST_PROCESSES = 8
"""Each process has a copy of the database, 1 MB or more per photo."""

LOOSE_RATIO = 0.9
"""Largest distance over the second best one, at the second look; COLMAP's default is 0.8."""

MAX_SECOND_LOOK = 20
"""The most photos that are matched again with all others."""

_TASK = "matching"


def extract(workspace: Workspace, size: int, quick: bool) -> None:
    """Write cameras, images and features of all photos into a new database.

    All images are numbered before the search begins, so that results do not depend on threads.

    ``size``: longer side of the largest photo, pixels; ``quick``: find fewer features.
    """
    pycolmap = workspace.pycolmap
    workspace.open().close()  # pycolmap imports into a database that exists
    for camera in sorted(set(workspace.cameras)):
        # The photos of one camera share its focal length and distortion.
        importing = pycolmap.ImageReaderOptions()
        importing.camera_model = "SIMPLE_RADIAL"
        cameras = zip(workspace.names, workspace.cameras, strict=True)
        workspace.call(
            pycolmap.import_images,
            workspace.database,
            workspace.images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            image_names=[name for name, own in cameras if own == camera],
            options=importing,
        )
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = THREADS
    options.max_image_size = FINEST_SIZE
    options.sift.max_num_features = QUICK_FEATURES if quick else MAX_FEATURES
    options.sift.first_octave = -1 if size <= DOUBLED_SIZE else 0
    options.sift.peak_threshold = PEAK_THRESHOLD
    reader = pycolmap.ImageReaderOptions()
    if workspace.masks is not None:
        reader.mask_path = workspace.masks
    total = len(workspace.names)
    for start in range(0, total, BATCH):
        workspace.on_progress("features", start, total)
        workspace.call(
            pycolmap.extract_features,
            workspace.database,
            workspace.images,
            image_names=workspace.names[start : start + BATCH],
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
    workspace.on_progress("features", total, total)


def match(
    workspace: Workspace,
    pairs: list[tuple[int, int]],
    stage: str = "matches",
    ratio: float | None = None,
) -> None:
    """Match and verify pairs of photos, in several processes, and write the results.

    The result does not depend on the number of processes.

    ``pairs`` are places in ``workspace.names``; ``ratio`` is the largest distance of a match over
    the second best one, by default COLMAP's.

    Raises:
        DataError: pycolmap fails.
    """
    ordered = sorted(pairs, key=lambda pair: (pair[0] // TILE, pair[1] // TILE, pair))
    named = [(workspace.names[i], workspace.names[j]) for i, j in ordered]
    processes = min(THREADS, MOST_PROCESSES)
    size = max(1, min(GROUP, -(-len(named) // processes)))
    groups = [named[start : start + size] for start in range(0, len(named), size)]
    shares = [share for k in range(processes) if (share := groups[k::processes])]
    matched, one_at_a_time = 0, threading.Lock()

    def count(more: int) -> None:
        nonlocal matched
        with one_at_a_time:
            matched += more
            workspace.on_progress(stage, matched, len(pairs))

    count(0)
    copies = [
        replace(workspace, folder=workspace.folder / f"matching_{number}")
        for number in range(len(shares))
    ]
    with ThreadPoolExecutor(max(1, len(shares))) as pool:
        for copy in copies:
            copy.folder.mkdir()
            shutil.copyfile(workspace.database, copy.database)
        running = [
            pool.submit(
                run_child, __name__, _TASK, [str(copy.folder), share, ratio, copy.seed], count
            )
            for copy, share in zip(copies, shares, strict=True)
        ]
        for future in running:
            future.result()
    for copy, share in zip(copies, shares, strict=True):
        with workspace.open() as whole, copy.open() as found:
            ids = dict(zip(workspace.names, workspace.ids(whole), strict=True))
            for first, second in ((ids[a], ids[b]) for group in share for a, b in group):
                whole.write_matches(first, second, found.read_matches(first, second))
                geometry = found.read_two_view_geometry(first, second)
                whole.write_two_view_geometry(first, second, geometry)
        shutil.rmtree(copy.folder)


def work(arguments: Any, on_stage: OnStage) -> None:
    """Be the child: match groups of pairs of names, one after the other, in a folder's database."""
    folder, groups, ratio, seed = arguments
    with quiet_pycolmap(_TASK) as pycolmap:
        workspace = Workspace(pycolmap, Path(folder), Path(folder), [], [], seed, lambda *_: None)
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = workspace.folder / "pairs.txt"
        options = pycolmap.FeatureMatchingOptions()
        options.use_gpu = False
        options.num_threads = 1
        if ratio is not None:
            options.sift.max_ratio = ratio
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        for group in groups:
            lines = (f"{first} {second}\n" for first, second in group)
            pairing.match_list_path.write_text("".join(lines))
            workspace.call(
                pycolmap.match_image_pairs,
                workspace.database,
                matching_options=options,
                pairing_options=pairing,
                verification_options=verification,
                device=pycolmap.Device.cpu,
            )
            on_stage(len(group))


def match_again(workspace: Workspace, left_out: list[int]) -> None:
    """Match photos, by their place in ``workspace.names``, with all others, less strictly."""
    left_out = left_out[:MAX_SECOND_LOOK]
    chosen = set(left_out)
    pairs = [(i, j) for i, j in all_pairs(len(workspace.names)) if i in chosen or j in chosen]
    with workspace.open() as database:
        ids = workspace.ids(database)
        for first, second in ((ids[i], ids[j]) for i, j in pairs):
            if database.exists_matches(first, second):
                database.delete_matches(first, second)
            if database.exists_two_view_geometry(first, second):
                database.delete_two_view_geometry(first, second)
    match(workspace, pairs, "second look", LOOSE_RATIO)


def read_evidence(workspace: Workspace) -> Evidence:
    """Read all verified pairs of the database that have at least MIN_MATCHES matches."""
    with workspace.open() as database:
        keypoints = {
            number: np.asarray(database.read_keypoints(number), np.float64)[:, :2]
            for number in workspace.ids(database)
        }
        numbers, geometries = database.read_two_view_geometries()
    pairs = []
    for number, geometry in zip(numbers, geometries, strict=True):
        matches = np.asarray(geometry.inlier_matches, np.uint32).reshape(-1, 2)
        if len(matches) >= MIN_MATCHES:
            first, second = workspace.pycolmap.pair_id_to_image_pair(number)
            pairs.append(MatchedPair(first, second, matches))
    return Evidence(pairs, keypoints)
