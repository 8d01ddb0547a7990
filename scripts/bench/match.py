"""Matching of descriptors, compared with pycolmap's matchers on the same pairs.

``match.py FOLDER [--photos N] [--features N ...] [--repeats N]``: all pairs of the first N photos
of a folder, matched by their largest features: on the OpenCL device, by pycolmap without a GPU
(FAISS), and by its brute force, interleaved. Prints milliseconds per pair, the median over
turns, and how many matches each of pycolmap's has more and fewer. Nothing is verified.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.opencl.device import Device
from clgs.ops.match import upload
from clgs.poses.pycolmap_child import quiet_pycolmap
from clgs.poses.stages.matching import MAX_RATIO, mutual_matches, turn_and_scale

Bytes = npt.NDArray[np.uint8]
Found = set[tuple[int, int, int, int]]


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=int, default=6)
    parser.add_argument("--features", type=int, nargs="+", default=[2048, 4096, 8192])
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    device = Device()
    with quiet_pycolmap("matching") as pycolmap:
        photos = extract(pycolmap, args.folder, args.photos)
        print(f"{device.name}, {len(photos)} photos of {args.folder.name}")
        for features in args.features:
            compare(pycolmap, device, [photo[:features] for photo in photos], args.repeats)


def extract(pycolmap: Any, folder: Path, count: int) -> list[Bytes]:
    """Find descriptors of the first photos of a folder, those of the largest features first."""
    names = sorted(path.name for path in folder.iterdir() if path.is_file())[:count]
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.sift.max_num_features = 16384
    options.sift.peak_threshold = 0.001
    photos = list[Bytes]()
    with tempfile.TemporaryDirectory() as work:
        database = Path(work) / "database.db"
        pycolmap.Database.open(database).close()
        pycolmap.extract_features(
            database,
            folder,
            image_names=names,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
        with pycolmap.Database.open(database) as opened:
            for number in sorted(image.image_id for image in opened.read_all_images()):
                keypoints = np.asarray(opened.read_keypoints(number), np.float64)
                largest = np.argsort(-turn_and_scale(keypoints)[:, 1], kind="stable")
                photos.append(opened.read_descriptors(number).data[largest])
    return photos


def compare(pycolmap: Any, device: Device, photos: list[Bytes], repeats: int) -> None:
    """Print a line of each matcher."""
    pairs = [(a, b) for a in range(len(photos)) for b in range(a + 1, len(photos))]
    seconds: dict[str, list[float]] = {"clgs": [], "FAISS": [], "brute force": []}
    found: dict[str, Found] = {}
    for _ in range(repeats + 1):
        began = time.perf_counter()
        matches = mutual_matches(device, upload(device, photos), photos, pairs, MAX_RATIO)
        seconds["clgs"].append(time.perf_counter() - began)
        found["clgs"] = {
            (a, b, int(i), int(j))
            for (a, b), one in zip(pairs, matches, strict=True)
            for i, j in one
        }
        for name in ("FAISS", "brute force"):
            found[name], one = match_by_pycolmap(pycolmap, photos, name == "brute force")
            seconds[name].append(one)
    print(f"{len(pairs)} pairs, at most {max(len(photo) for photo in photos)} features per photo")
    for name, taken in seconds.items():
        median = 1000 * statistics.median(taken[1:]) / len(pairs)  # the first turn builds programs
        more, fewer = len(found[name] - found["clgs"]), len(found["clgs"] - found[name])
        print(
            f"  {name:12} {median:8.1f} ms per pair, {len(found[name])} matches: +{more} -{fewer}"
        )


def match_by_pycolmap(pycolmap: Any, photos: list[Bytes], brute_force: bool) -> tuple[Found, float]:
    """Match all pairs; also returns seconds."""
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.skip_geometric_verification = True
    matching.sift.cpu_brute_force_matcher = brute_force
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "database.db"
        with pycolmap.Database.open(path) as database:
            numbers = [add_photo(pycolmap, database, photo) for photo in photos]
        began = time.perf_counter()
        pycolmap.match_exhaustive(path, matching_options=matching, device=pycolmap.Device.cpu)
        taken = time.perf_counter() - began
        with pycolmap.Database.open(path) as database:
            return {
                (a, b, int(i), int(j))
                for a, first in enumerate(numbers)
                for b, second in enumerate(numbers[a + 1 :], a + 1)
                if database.exists_matches(first, second)
                for i, j in database.read_matches(first, second)
            }, taken


def add_photo(pycolmap: Any, database: Any, descriptors: Bytes) -> int:
    """Write a photo that has these descriptors, and features at no particular place."""
    camera = pycolmap.Camera.create_from_model_id(
        0, pycolmap.CameraModelId.SIMPLE_PINHOLE, 1000.0, 1000, 1000
    )
    camera.camera_id = database.write_camera(camera)
    name = str(database.num_images())
    number = database.write_image(pycolmap.Image(name=name, camera_id=camera.camera_id))
    database.write_keypoints(number, np.zeros((len(descriptors), 4), np.float32))
    kind = pycolmap.FeatureExtractorType.SIFT
    database.write_descriptors(number, pycolmap.FeatureDescriptors(kind, descriptors))
    return int(number)


if __name__ == "__main__":
    main()
