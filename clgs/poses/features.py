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
