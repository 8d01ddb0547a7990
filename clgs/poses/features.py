"""SIFT features of the photos, by pycolmap, into the database."""

from __future__ import annotations

from clgs.poses.job import THREADS, Job

MAX_FEATURES = 8192
"""Of a photo; COLMAP's default. pycolmap prefers those of large size."""

QUICK_FEATURES = 4096

FINEST_SIZE = 3200
"""Features are searched in images of at most this longer side, pixels; COLMAP's default."""

DOUBLED_SIZE = 1600
"""Photos up to this size are searched at twice their resolution too, as COLMAP does by default.

Doubled images beyond FINEST_SIZE would take gigabytes of memory.
"""

PEAK_THRESHOLD = 0.004
"""Contrast a feature needs; COLMAP's 0.0067 finds too few in small photos."""

BATCH = 4 * THREADS
"""Photos between two reports of progress."""


def extract(job: Job, size: int, quick: bool) -> None:
    """Cameras, images and features of all photos.

    All images are numbered before their features are searched, so that results depend on no thread.

    Args:
        job: the reconstruction.
        size: longer side of the largest photo, pixels.
        quick: fewer features.
    """
    job.open().close()  # pycolmap reads into one that exists
    for camera in sorted(set(job.cameras)):
        _import_images(job, camera)
    options = job.pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = THREADS
    options.max_image_size = FINEST_SIZE
    options.sift.max_num_features = QUICK_FEATURES if quick else MAX_FEATURES
    options.sift.first_octave = -1 if size <= DOUBLED_SIZE else 0
    options.sift.peak_threshold = PEAK_THRESHOLD
    reader = job.pycolmap.ImageReaderOptions()
    if job.masks is not None:
        reader.mask_path = job.masks
    total = len(job.names)
    for start in range(0, total, BATCH):
        job.on_progress("features", start, total)
        job.call(
            job.pycolmap.extract_features,
            job.database,
            job.images,
            image_names=job.names[start : start + BATCH],
            reader_options=reader,
            extraction_options=options,
            device=job.pycolmap.Device.cpu,
        )
    job.on_progress("features", total, total)


def _import_images(job: Job, camera: int) -> None:
    """The photos of one camera, which share its focal length and distortion."""
    reader = job.pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    names = [name for name, own in zip(job.names, job.cameras, strict=True) if own == camera]
    mode = job.pycolmap.CameraMode.SINGLE
    job.call(
        job.pycolmap.import_images,
        job.database,
        job.images,
        camera_mode=mode,
        image_names=names,
        options=reader,
    )
