"""Poses that are known before: of another program, of a phone, or of a data set that grows.

They choose the pairs that are matched, and are refined by the matches instead of found again. If
matches contradict them, they are not used.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.dataset import read_photo_set
from clgs.data.images import image_size
from clgs.data.lens import Lens
from clgs.data.posed_photo import Photo, PhotoSet, from_plain, to_plain, to_y_up
from clgs.data.programs import FILES
from clgs.errors import DataError
from clgs.poses.evidence import Evidence, Poses, angle, common_similarity, differences, poses_of
from clgs.poses.find import Collection, Found, match_photos, new_name, read_sources, stem_of
from clgs.poses.workspace import Workspace
from clgs.scene.world import EARTH, LOCAL, MAP, NOWHERE, Place

Floats = npt.NDArray[np.float64]

MAX_OFF, MAX_ASTRAY = 5.0, 45.0
"""Degrees by which the turn between two photos, and the direction from one to the other, may be off
those of their matches, at the median."""

SEEN_APART = 1.5
"""Degrees between the rays to what two photos share, from which they show a direction."""

ENOUGH_PAIRS = 5
"""Directions are not asked if there are fewer."""

MIXED_UP = {
    "camera to world is taken for world to camera": (True, 1),
    "OpenGL's axes of cameras are taken for OpenCV's": (False, -1),
    "camera to world is taken for world to camera, and OpenGL's axes for OpenCV's": (True, -1),
}
"""What may be wrong with all poses: whether they are inverted, and the sign of cameras' y and z."""

NAMED = 5

ASKED = 200
"""The most pairs that test the poses."""

FISHEYE, PERSPECTIVE = "OPENCV_FISHEYE", "OPENCV"
"""COLMAP's models of the lenses that come with poses."""

LOOSE, STRICT = 16.0, 4.0
"""Largest errors of matches, pixels: before the poses are refined, and after that."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Known:
    """Poses that were given, in the world that ``kind``, ``frame`` and ``place`` tell.

    source: what they were read from, for messages; photos: by the stem of the photo's name in the
    data set to be made; kind, frame, place: as of PhotoSet.
    """

    source: str = ""
    photos: Mapping[str, Photo] = field(default_factory=dict)
    kind: str = "colmap"
    frame: int = LOCAL
    place: Place = NOWHERE

    def plain(self) -> dict[str, Any]:
        """Convert to what JSON can hold."""
        return {**vars(self), "photos": {stem: to_plain(one) for stem, one in self.photos.items()}}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Known:
        """Make this of what :meth:`plain` returned."""
        photos = {stem: from_plain(photo) for stem, photo in plain["photos"].items()}
        return cls(**{**plain, "photos": photos, "place": tuple(plain["place"])})


def read_known(source: Path, found: Collection) -> Known:
    """Read the poses that a data set of any program, or one of its files, has for found photos.

    :func:`clgs.poses.find.match_photos` says which photo is which.

    Raises:
        DataError: no data set, a damaged one, or one of other photos.
    """
    given = _read_set(source, found.root)
    posed = given.train + given.test
    same, unsure = match_photos(found.photos, posed, read_sources(_folder_of(source)))
    photos = {Path(found.photos[file].name).stem: posed[photo] for photo, file in same.items()}
    several = sorted(posed[number].name for number in unsure)
    if not photos:
        raise DataError(
            f"{source}: none of its {len(posed)} photos is in {found.root}; name the poses of "
            "these photos"
        )
    lost = [one.name for n, one in enumerate(posed) if n not in same and n not in unsure]
    if lost := sorted(lost + given.missing):
        _log.warning(
            "%s: %s lacks %d of its photos: %s", *(source, found.root, len(lost), _some(lost))
        )
    if several:
        _log.warning(
            "%s: %d of its photos may be several of %s, and their poses are not used: %s",
            *(source, len(several), found.root, _some(several)),
        )
    return Known(str(source), photos, given.kind, given.frame, given.place)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + ", ..." * (len(names) > NAMED)


def _folder_of(source: Path) -> Path:
    return source.parent if source.is_file() else source


def _read_set(source: Path, photos: Path) -> PhotoSet:
    """Read a data set, or that of a file; the photos of some files may lie in ``photos`` alone."""
    if not source.exists():
        raise DataError(f"{source}: no such file or folder; check the path")
    read = FILES.get(source.suffix.lower()) if source.is_file() else None
    if read is None:
        return read_photo_set(_folder_of(source))
    try:
        return read(photos, source)
    except DataError:
        return read(source.parent, source)


def add_photos(source: Path, found: Collection) -> None:
    """Add the photos of a data set, with their masks, to those that were found.

    Raises:
        DataError: no data set; or a new photo has the name of one of them, or there is none.
    """
    given = read_photo_set(source)
    own = {photo.path.resolve() for photo in given.train + given.test}
    found.photos = [one for one in found.photos if one.path.resolve() not in own]
    if not found.photos:
        raise DataError(f"{found.root}: has no photo that {source} lacks; add some")
    new = {
        stem: one.path
        for one in found.photos
        for stem in (stem_of(one.path), stem_of(Path(one.name)))
    }
    taken = {Path(one.name).stem.lower() for one in found.photos}
    sources = read_sources(source)
    for photo in sorted(given.train + given.test, key=lambda one: one.name):
        if (other := new.get(stem_of(photo.path))) is not None:
            raise DataError(f"{other}: {source} has a photo of this name; rename the new one")
        name = new_name(photo.path.name, taken)
        below = sources.get(photo.path.stem, photo.path.name)
        found.photos.append(Found(photo.path, name, below, photo.mask))


def fitting(known: Known, files: Sequence[Path]) -> tuple[dict[str, Photo], list[str]]:
    """Choose the given poses whose lens suits the photo's pixels.

    Args:
        known: the given poses.
        files: the photos, named as in the data set to be made.

    Returns:
        The photos with a pose by the file's name, their lenses at the size of the file; and a note
        if some do not fit.
    """
    fit, other = {}, list[str]()
    for file in files:
        photo = known.photos.get(file.stem)
        if photo is None:
            continue
        width, height = image_size(file)
        if abs(width * photo.lens.height - height * photo.lens.width) > max(width, height):
            other.append(file.name)
        else:
            fit[file.name] = replace(photo, lens=photo.lens.resized(width, height))
    if not other:
        return fit, []
    return fit, [
        f"{known.source}: {len(other)} poses are not used, the shape of their pictures is another "
        f"than that of the photos: {', '.join(other[:NAMED])}"
    ]


def set_lenses(workspace: Workspace) -> list[Any]:
    """Give the database's cameras the median lens of their photos with a pose.

    Returns:
        The cameras as they were.
    """
    lenses = defaultdict[int, list[Lens]](list)
    with workspace.open() as database:
        for name, photo in workspace.known.items():
            lenses[database.read_image_with_name(name).camera_id].append(photo.lens)
        before = [database.read_camera(number) for number in sorted(lenses)]
        for number, some in lenses.items():
            radial = np.array([(*one.radial, 0.0, 0.0, 0.0, 0.0)[:4] for one in some])
            rest = radial if some[0].fisheye else radial[:, :2]
            pixels = np.array([(one.fx, one.fy, one.cx, one.cy) for one in some])
            bent = np.zeros((len(some), 0))
            if not some[0].fisheye:
                bent = np.array([one.tangential for one in some])
            camera = workspace.pycolmap.Camera(
                model=FISHEYE if some[0].fisheye else PERSPECTIVE,
                width=some[0].width,
                height=some[0].height,
                params=np.median(np.hstack([pixels, rest, bent]), axis=0),
                camera_id=number,
            )
            camera.has_prior_focal_length = True
            database.update_camera(camera)
    return before


def put_back(workspace: Workspace, cameras: Sequence[Any]) -> None:
    """Undo :func:`set_lenses`."""
    with workspace.open() as database:
        for camera in cameras:
            database.update_camera(camera)


def contradiction(workspace: Workspace, evidence: Evidence) -> str:
    """Test given poses by the two-view geometries of neighbours.

    Returns:
        Why the poses cannot be used; empty if the matches confirm them.
    """
    found, given, apart = _geometries(workspace, evidence)
    if not found:
        return "no two of the photos that they place next to each other match"
    far = np.array(apart) >= SEEN_APART
    turns = np.array([one.rotation.matrix() for one in found])
    steps = np.array([one.translation for one in found])
    rotation, move = (
        np.array([[getattr(one, name) for one in pair] for pair in given])
        for name in ("rotation", "translation")
    )

    def off(inverted: bool, sign: int) -> tuple[float, float]:
        axes = np.diag([1.0, sign, sign])
        turned = rotation.swapaxes(2, 3) if inverted else rotation
        centre = move if inverted else -np.einsum("npji,npj->npi", rotation, move)
        first, second = (axes @ turned).swapaxes(0, 1)
        turn = float(np.median(angle(turns @ first @ second.swapaxes(1, 2))))
        if far.sum() < ENOUGH_PAIRS:
            return turn, 0.0
        way = np.einsum("nij,nj->ni", second, centre[:, 0] - centre[:, 1])[far]
        length = np.linalg.norm(way, axis=1) * np.linalg.norm(steps[far], axis=1)
        cosine = np.einsum("ni,ni->n", way, steps[far]) / np.maximum(length, 1e-300)
        return turn, float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))

    turn, astray = off(False, 1)
    if turn <= MAX_OFF and astray <= MAX_ASTRAY:
        return ""
    why = f"matches contradict them by {turn:.0f} degrees"
    if turn <= MAX_OFF:
        why = f"matches contradict the directions between their cameras by {astray:.0f} degrees"
    for words, mixed_up in MIXED_UP.items():
        if np.all(np.array(off(*mixed_up)) <= (MAX_OFF, MAX_ASTRAY)):
            return f"{why}; it seems that {words}"
    return why


def _geometries(
    workspace: Workspace, evidence: Evidence
) -> tuple[list[Any], list[tuple[Photo, Photo]], list[float]]:
    """Read the two-view geometries of neighbours with a given pose.

    Returns:
        For each pair the pose of its second photo as its first one sees it, with a step of any
        length; the given poses; and degrees between the rays to what both see.
    """
    found, given, apart = list[Any](), list[tuple[Photo, Photo]](), list[float]()
    with workspace.open() as database:
        names = {n: database.read_image(n).name for n in workspace.ids(database)}
        cameras = {n: database.read_camera(database.read_image(n).camera_id) for n in names}
        known = {n: workspace.known[name] for n, name in names.items() if name in workspace.known}
        # the best match of a photo may well be a new one
        pairs = [one for one in evidence.pairs if one.first in known and one.second in known]
        for pair in replace(evidence, pairs=pairs).strongest(1)[:ASKED]:
            both = pair.first, pair.second
            geometry = database.read_two_view_geometry(*both)
            points = [evidence.keypoints[number] for number in both]
            if workspace.pycolmap.estimate_two_view_geometry_pose(
                *(cameras[both[0]], points[0], cameras[both[1]], points[1]), geometry
            ):
                found.append(geometry.cam2_from_cam1)
                given.append((known[both[0]], known[both[1]]))
                apart.append(np.degrees(geometry.tri_angle))
    return found, given, apart


def map_known(workspace: Workspace, folder: Path) -> Any:
    """Triangulate the matches at the given poses, and refine poses, lenses and points.

    Returns:
        pycolmap's reconstruction of the photos with a given pose.
    """
    pycolmap = workspace.pycolmap
    with workspace.open() as database:
        cache = pycolmap.DatabaseCache.create(database, pycolmap.DatabaseCacheOptions())
    model = pycolmap.Reconstruction()
    model.load(cache)
    for image in model.images.values():
        if (photo := workspace.known.get(image.name)) is not None:
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(photo.rotation), photo.translation)
            model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
            model.register_frame(image.frame_id)
    adjusting = pycolmap.BundleAdjustmentOptions()
    adjusting.print_summary = False
    adjusting.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    adjusting.ceres.solver_options.num_threads = 1
    # What is triangulated last rests on poses that are refined.
    for number, error in enumerate((LOOSE, STRICT, STRICT)):
        if number:
            # as pycolmap.bundle_adjustment, which makes pycolmap log all that follows
            pycolmap.ObservationManager(model).filter_observations_with_negative_depth()
            config = pycolmap.BundleAdjustmentConfig()
            for image_id in model.reg_image_ids():
                config.add_image(image_id)
            config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
            pycolmap.create_default_bundle_adjuster(adjusting, config, model).solve()
        options = workspace.pipeline_options()
        options.mapper.filter_max_reproj_error = error
        options.triangulation.merge_max_reproj_error = error
        options.triangulation.complete_max_reproj_error = error
        out = folder / f"triangulated_{number}"
        out.mkdir(parents=True)
        model = workspace.call(
            pycolmap.triangulate_points,
            *(model, workspace.database, workspace.images, out),
            options=options,
        )
    return model


def to_given_world(workspace: Workspace, model: Any, known: Known) -> float | None:
    """Put a model into the world of the given poses, as its photos suit best.

    A COLMAP model has no up of its own: a world whose up is known is turned so that it is -y, which
    is what a COLMAP model's is taken for, unless it lies on the Earth.

    Returns:
        The degrees by which the model turns the given poses, at the median; None if there are none,
        or they do not agree with the model.
    """
    poses = poses_of(model)
    names = [name for name in poses.names if name in workspace.known]
    if not names:
        return None
    photos = [workspace.known[name] for name in names]
    rotation, centre = (np.array([getattr(p, n) for p in photos]) for n in ("rotation", "centre"))
    own, given = poses.chosen(names), Poses(names, rotation, centre, np.ones(len(names)))
    between = common_similarity(own, given)
    off = float(np.median([one.turn for one in differences(own, given).values()] or [0.0]))
    if off > MAX_OFF or not (np.isfinite(between.scale) and between.scale > 0.0):
        return None
    turn = np.eye(3)
    if known.frame not in (EARTH, MAP):
        turn = to_y_up("colmap", LOCAL).T @ to_y_up(known.kind, known.frame)
    rotated = workspace.pycolmap.Rotation3d(turn @ between.turn)
    model.transform(workspace.pycolmap.Sim3d(between.scale, rotated, turn @ between.offset))
    return off
