"""Matches of some of the pairs, in a process of its own.

On several threads pycolmap 4.2.1 now and then loses most matches of a pair: of 719 in photos of a
can 42 were left. It seems that threads in OpenBLAS spoil each other's products; so every process
matches on one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from clgs.poses.child import OnStage, run_child, serve
from clgs.poses.job import Job
from clgs.poses.pycolmap_lazy import quiet_pycolmap

TASK = "matching"

Pairs = list[tuple[str, str]]
"""Names of files."""


def match_part(
    job: Job, groups: list[Pairs], ratio: float | None, on_matched: Callable[[int], None]
) -> None:
    """Match and verify the pairs of every group, into the database of ``job``.

    Args:
        job: a part of a reconstruction, whose database nothing else uses meanwhile.
        groups: matched one after the other.
        ratio: of the best over the second best distance at most; None: COLMAP's default.
        on_matched: told how many pairs more are done.

    Raises:
        DataError: pycolmap fails.
    """
    run_child(__name__, TASK, [str(job.folder), groups, ratio, job.seed], on_matched)


def main() -> None:
    """The process that does the work."""
    serve(_work)


def _work(arguments: Any, on_stage: OnStage) -> None:
    folder, groups, ratio, seed = arguments
    with quiet_pycolmap(TASK) as pycolmap:
        job = Job(pycolmap, Path(folder), Path(folder), [], [], seed, lambda *told: None)
        for group in groups:
            _match(job, group, ratio)
            on_stage(len(group))


def _match(job: Job, pairs: Pairs, ratio: float | None) -> None:
    listed = job.folder / "pairs.txt"
    listed.write_text("".join(f"{first} {second}\n" for first, second in pairs))
    pairing = job.pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    options = job.pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = 1
    if ratio is not None:
        options.sift.max_ratio = ratio
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
