"""Structure from motion by pycolmap, in a child process: the stages one after the other."""

from __future__ import annotations

import errno
import os
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from clgs.data.colmap_model import WORLD
from clgs.data.images import image_size
from clgs.data.masks import MASKS, save_mask
from clgs.errors import DataError
from clgs.machine import repeatedly
from clgs.opencl.device import Device
from clgs.poses.bring_in import camera_numbers
from clgs.poses.evidence import MAX_CONTRADICTED, ModelChoice, poses_of
from clgs.poses.gps import fit, read_positions
from clgs.poses.judge import judge, unconfirmed
from clgs.poses.known import (
    Known,
    contradiction,
    fitting,
    put_back,
    set_lenses,
    to_given_world,
)
from clgs.poses.pycolmap_child import CrashError, OnStage, quiet_pycolmap, run_child
from clgs.poses.stages.check import SecondReconstruction
from clgs.poses.stages.features import extract
from clgs.poses.stages.mapping import ask_all_mappers, look_again, map_photos
from clgs.poses.stages.matching import match, match_in_full, read_evidence
from clgs.poses.stages.more_points import STAGE, add_points
from clgs.poses.stages.pairs import pairs_to_match
from clgs.poses.unfinished import Finished
from clgs.poses.verdict import Verdict, point_figures, verdict_of
from clgs.poses.video import JPEG_QUALITY
from clgs.poses.workspace import OnProgress, Workspace
from clgs.scene.world import EARTH, LOCAL, NOWHERE, Place, to_text

LEAST_ROOM = 1 << 20
"""Bytes; a failure with less free space is blamed on the disk."""

SECOND_THOUGHTS = 2
"""Choices of a model after the first one, if doubt remains: by all mappers, then photo by photo."""

COUNT_SECONDS = 0.5
"""Time between two counts of the undistorted photos."""

_TASK = "structure from motion"


def reconstruct(
    target: Path,
    seed: int,
    quick: bool,
    max_size: int,
    device: str | None,
    on_progress: OnProgress,
    known: Known,
    apart: bool,
    finished: Path,
) -> Verdict:
    """Find poses and points of the photos in ``target``/work/images: fills images/ and sparse/0/.

    ``quick``: half the features, one mapper, no second reconstruction. ``max_size``: photos are
    reduced to about this width at the end; 0: never. ``device``: matches features, as for Device.
    ``on_progress`` receives the progress of each stage after "read". ``known``: poses that are
    given; ``apart``: photos with such a pose share no camera with the others. ``finished``: folder
    of pieces that are taken up and kept.

    Raises:
        DataError: no reconstruction, no pycolmap, or it crashed.
        DeviceError: there is no such device.
        OSError: it failed on a full disk.
    """
    arguments = [str(target), seed, quick, max_size, device, known.plain(), apart, str(finished)]
    try:
        return verdict_of(run_child(__name__, _TASK, arguments, lambda one: on_progress(*one)))
    except DataError as error:
        if shutil.disk_usage(target).free < LEAST_ROOM:  # SQLite ends the process then
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target)) from error
        raise


def work(arguments: Any, on_stage: OnStage) -> dict[str, Any]:
    """Be the child: run all stages for the photos in a folder; returns a plain verdict."""
    target, (seed, quick, max_size, device, given, apart, kept) = Path(arguments[0]), arguments[1:]
    work, known = target / "work", Known.of_plain(given)
    finished = Finished(Path(kept))

    def on_progress(stage: str, done: int, total: int) -> None:
        finished.begin(stage)
        on_stage([stage, done, total])

    with quiet_pycolmap(_TASK) as pycolmap, SecondReconstruction() as check:
        photos = sorted((work / "images").iterdir())
        posed, notes = fitting(known, photos)
        positions, origin, more = read_positions(photos)
        notes += more
        cameras = camera_numbers(photos, known.photos if apart else ())
        workspace = Workspace(
            *(pycolmap, Device(device), work / "images", work),
            *([photo.name for photo in photos], cameras, seed, on_progress),
            masks=work / MASKS if (work / MASKS).is_dir() else None,
            known=posed,
            positions=positions,
            finished=finished,
        )
        pycolmap.set_random_seed(seed)
        extract(workspace, max(max(image_size(photo)) for photo in photos), quick)
        early = None if quick else check
        workspace, choice, shortened = _match_and_map(workspace, known, early, notes)
        choice = look_again(workspace, choice)
        second = None if quick else check.model(workspace, choice)
        for _ in range(0 if quick else SECOND_THOUGHTS):
            before, doubtful = choice, unconfirmed(choice, second)
            choice = ask_all_mappers(workspace, before, doubtful) if doubtful else before
            if choice is before:
                break
            second = check.model(workspace, choice)
        if not quick and (doubtful := unconfirmed(choice, second)):
            second = check.replace_doubtful(doubtful)
        verdict = judge(choice, second, not quick, workspace.names)
        if verdict.registered < 2:
            raise DataError(
                "no photo could be placed for certain; take more, overlapping photos of a "
                "textured, motionless scene"
            )
        model = choice.kept.reconstruction
        if shortened:
            (model,) = workspace.models(
                STAGE, lambda: [add_points(workspace, model, choice.evidence)]
            )
            verdict = replace(verdict, **point_figures(model))
        world = _put_into_world(workspace, model, known, origin, notes)
        _write_data_set(workspace, model, target, max_size)
        if line := to_text(*world):
            (target / WORLD).write_text(line + "\n", encoding="utf-8")
    return asdict(replace(verdict, seconds=finished.seconds(), notes=tuple(notes)))


def _match_and_map(
    workspace: Workspace,
    known: Known,
    check: SecondReconstruction | None,
    notes: list[str],
) -> tuple[Workspace, ModelChoice, bool]:
    """Match the photos and find a model.

    ``check`` may begin with all evidence before a model is looked for; None: in a hurry.

    Returns:
        The workspace without poses that are refuted, the model, and whether features were left out.
    """
    quick, cameras = check is None, set_lenses(workspace)
    pairs = pairs_to_match(workspace)
    shortened = match(workspace, pairs)
    evidence = read_evidence(workspace)
    if workspace.known and (why := contradiction(workspace, evidence)):
        notes.append(f"{known.source}: its poses are not used: {why}")
        put_back(workspace, cameras)
        workspace = replace(workspace, known={})
        more = sorted(set(pairs_to_match(workspace)).difference(pairs))
        shortened |= match(workspace, more)
        pairs, evidence = sorted({*pairs, *more}), read_evidence(workspace)
    while True:
        if check:
            check.begin_early(workspace, evidence)
        try:
            choice = map_photos(workspace, evidence, quick)
        except CrashError:
            if not (check and check.give_up()):
                raise
            choice = map_photos(workspace, evidence, quick)  # once more, alone
        if quick or not shortened or choice.kept.explained.contradicted <= MAX_CONTRADICTED:
            return workspace, choice, shortened
        match_in_full(workspace, pairs)  # what looks alike may differ in small features
        shortened, evidence = False, read_evidence(workspace)


def _put_into_world(
    workspace: Workspace,
    model: Any,
    known: Known,
    origin: Place,
    notes: list[str],
) -> tuple[int, Place]:
    """Move a model to where poses or GPS tags say that it is; returns what its world is then."""
    turn = to_given_world(workspace, model, known)
    if turn is not None:
        notes.append(
            f"{known.source}: the world is that of its {len(workspace.known)} poses, half of which "
            f"are turned by at most {turn:.2f} degrees"
        )
        return known.frame, known.place
    found, lines = fit(workspace, poses_of(model))
    notes += lines
    if found is None:
        return LOCAL, NOWHERE
    model.transform(found)
    return EARTH, origin


def _write_data_set(workspace: Workspace, model: Any, target: Path, max_size: int) -> None:
    """Write undistorted images, their masks, and the model with pinhole cameras into ``target``.

    Photos wider than ``max_size`` pixels are reduced to about that width, unless it is 0.
    """
    options = workspace.pycolmap.UndistortCameraOptions()
    if max_size:
        upright = max(camera.height / camera.width for camera in model.cameras.values())
        options.max_image_size = round(max_size * max(upright, 1.0))  # of the longer side
    work = workspace.folder
    (work / "model").mkdir()
    model.write(work / "model")
    made, total = work / "undistorted" / "images", model.num_reg_images()

    def count() -> None:  # pycolmap does not report it
        done = sum(len(names) for _, _, names in os.walk(made))
        workspace.on_progress("undistort", done, total)

    count()
    with repeatedly(count, COUNT_SECONDS):
        workspace.pycolmap.undistort_images(
            *(work / "undistorted", work / "model", workspace.images),
            undistort_options=options,
            jpeg_quality=JPEG_QUALITY,
        )
    count()
    made.rename(target / "images")
    if workspace.masks is not None:
        _write_masks(workspace, model, workspace.masks, target, options)
    (target / "sparse").mkdir()
    (work / "undistorted" / "sparse").rename(target / "sparse" / "0")


def _write_masks(workspace: Workspace, model: Any, masks: Path, target: Path, options: Any) -> None:
    """Undistort masks as the photos of ``target``/images.

    ``model`` has the cameras of the photos as they were taken. ``masks`` holds NAME.png for the
    photo NAME. ``options``: as the photos were undistorted.
    """
    pycolmap, total = workspace.pycolmap, model.num_reg_images()
    for number, image in enumerate(model.images.values(), 1):
        workspace.on_progress("masks", number, total)
        file = masks / f"{image.name}.png"
        if not (file.is_file() and (target / "images" / image.name).is_file()):
            continue
        level = np.asarray(Image.open(file).convert("L"))
        (target / MASKS).mkdir(exist_ok=True)
        bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(level))
        camera = model.cameras[image.camera_id]
        undistorted, _ = pycolmap.undistort_image(options, bitmap, camera)
        used = np.asarray(undistorted.to_array()).reshape(undistorted.height, undistorted.width, -1)
        save_mask((used[..., 0] == 255).astype(np.uint8), target / MASKS / f"{image.name}.png")
