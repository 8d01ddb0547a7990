"""Two-view geometries of matched photos, by pycolmap in several child processes."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from clgs.poses.evidence import MIN_MATCHES
from clgs.poses.pycolmap_child import OnStage, quiet_pycolmap, run_child
from clgs.poses.workspace import THREADS, Workspace

MOST_PROCESSES = 8
"""Each process has a copy of the database, 1 MB or more per photo."""

REPORTED = 50
"""Pairs between two reports of progress."""

MIN_SHARE, SLACK = 0.25, 0.8
"""The least share of inliers that random samples look for; COLMAP's default is the first.

A pair needs MIN_MATCHES of them: of few matches that is a larger share, and fewer samples find it.
Without this most of the time goes to pairs of few matches that are all wrong.
"""

_TASK = "two-view geometry"


def verify(workspace: Workspace, pairs: list[tuple[int, int]], stage: str) -> None:
    """Write the two-view geometry of matched pairs, by the images' numbers, into the database.

    The result does not depend on the number of processes.

    Raises:
        DataError: pycolmap fails.
    """
    processes = min(THREADS, MOST_PROCESSES)
    shares = [share for k in range(processes) if (share := pairs[k::processes])]
    folders = [workspace.folder / f"verifying_{k}" for k in range(len(shares))]
    count = workspace.counter(stage, 0, len(pairs))
    with ThreadPoolExecutor(max(1, len(shares))) as pool:
        for folder in folders:
            folder.mkdir()
            shutil.copyfile(workspace.database, folder / workspace.database.name)
        running = [
            pool.submit(
                run_child,
                __name__,
                _TASK,
                [str(folder / workspace.database.name), share, workspace.seed],
                count,
            )
            for folder, share in zip(folders, shares, strict=True)
        ]
        for future in running:
            future.result()
    with workspace.open() as whole:
        for folder, share in zip(folders, shares, strict=True):
            with workspace.call(
                workspace.pycolmap.Database.open, folder / workspace.database.name
            ) as found:
                for first, second in share:
                    geometry = found.read_two_view_geometry(first, second)
                    whole.write_two_view_geometry(first, second, geometry)
            shutil.rmtree(folder)


def work(arguments: Any, on_stage: OnStage) -> None:
    """Be the child: find the geometries of pairs of images in the database at a path."""
    path, pairs, seed = arguments
    with quiet_pycolmap(_TASK) as pycolmap, pycolmap.Database.open(Path(path)) as database:
        numbers = sorted({number for pair in pairs for number in pair})
        points = {
            number: np.asarray(database.read_keypoints(number), np.float64)[:, :2]
            for number in numbers
        }
        cameras = {
            number: database.read_camera(database.read_image(number).camera_id)
            for number in numbers
        }
        options = pycolmap.TwoViewGeometryOptions()
        options.min_num_inliers = MIN_MATCHES
        options.ransac.random_seed = seed
        for done, (first, second) in enumerate(pairs, 1):
            matches = database.read_matches(first, second)
            options.ransac.min_inlier_ratio = max(MIN_SHARE, SLACK * MIN_MATCHES / len(matches))
            geometry = pycolmap.estimate_two_view_geometry(
                *(cameras[first], points[first], cameras[second], points[second]),
                matches,
                options,
            )
            database.write_two_view_geometry(first, second, geometry)
            if done % REPORTED == 0:
                on_stage(REPORTED)
        on_stage(len(pairs) % REPORTED)
