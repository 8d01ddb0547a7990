"""SIFT features of photos, by pycolmap."""

from __future__ import annotations

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
    kept = workspace.finished
    todo = [name for name in workspace.names if not _take_up(workspace, name)]
    total = len(workspace.names)
    for start in range(0, len(todo), BATCH):
        workspace.on_progress("features", total - len(todo) + start, total)
        some = todo[start : start + BATCH]
        workspace.call(
            pycolmap.extract_features,
            workspace.database,
            workspace.images,
            image_names=some,
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
        if kept is not None:
            with workspace.open() as database:
                for name in some:
                    number = database.read_image_with_name(name).image_id
                    descriptors = database.read_descriptors(number).data
                    kept.keep_features(name, database.read_keypoints(number), descriptors)
    workspace.on_progress("features", total, total)


def _take_up(workspace: Workspace, name: str) -> bool:
    """Write the features of a photo into the database if an earlier process found them."""
    found = workspace.finished and workspace.finished.features(name)
    if not found:
        return False
    keypoints, descriptors = found
    kind = workspace.pycolmap.FeatureExtractorType.SIFT
    with workspace.open() as database:
        number = database.read_image_with_name(name).image_id
        database.write_keypoints(number, keypoints)
        described = workspace.pycolmap.FeatureDescriptors(kind, descriptors)
        database.write_descriptors(number, described)
    return True
