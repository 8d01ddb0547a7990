"""Even exposures of the photos of a COLMAP data set, and scores that do not count exposure.

    exposure.py even DATA OUT           print each photo's exposure; OUT: a copy with even photos
    exposure.py score DATA WIDTH RUN    PSNR of held-out views: as they are, each multiplied by one
                                        number, and each with an affine map of its colors

A photo's exposure is the factor between what it shows of points and what the other photos do: the
median over the points that it sees. RUN: folder of a run; its views are rendered again.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

Floats = npt.NDArray[np.float64]
WIDTH = 320
"""Colors are means over about this many columns of a photo."""

DARK, BRIGHT = 0.06, 0.94
"""Colors outside of this are clipped, or noise."""

ROUNDS, QUALITY = 20, 97


def colors(data: Path) -> tuple[list[str], npt.NDArray[np.int64], npt.NDArray[np.int64], Floats]:
    """Names of photos; of each observation its photo, its point, and the logarithm of its color."""
    import pycolmap

    if not (data / "sparse" / "0" / "points3D.bin").is_file():
        raise SystemExit(f"{data}: no sparse/0/points3D.bin; give a data set of `clgs prepare`")
    model = pycolmap.Reconstruction(str(data / "sparse" / "0"))
    images = sorted(model.images.values(), key=lambda one: str(one.name))
    rows: list[tuple[int, int, float]] = []
    for number, image in enumerate(images):
        with Image.open(data / "images" / image.name) as photo:
            factor = max(1, photo.width // WIDTH)
            pixels = np.asarray(photo.convert("RGB").reduce(factor), np.float64) / 255
        for seen in image.points2D:
            x, y = (int(value / factor) for value in seen.xy)
            if seen.has_point3D() and 0 <= x < pixels.shape[1] and 0 <= y < pixels.shape[0]:
                color = pixels[y, x]
                if color.mean() > DARK and color.max() < BRIGHT:
                    rows.append((number, seen.point3D_id, float(np.log(color.mean()))))
    photo_of, point_id, value = map(np.asarray, zip(*rows, strict=True))
    point_of = np.unique(point_id, return_inverse=True)[1]
    return [image.name for image in images], photo_of, point_of, value


def exposures(data: Path) -> tuple[list[str], Floats]:
    """Names of photos and the logarithms of their exposures, whose median is 0."""
    names, photo_of, point_of, value = colors(data)
    count, found = np.bincount(point_of), np.zeros(len(names))
    for _ in range(ROUNDS):
        mean = np.bincount(point_of, value - found[photo_of]) / count
        apart = value - mean[point_of]
        found = np.array([np.median(apart[photo_of == i]) for i in range(len(names))])
        found -= np.median(found)
    return names, found


def even(data: Path, output: Path) -> None:
    """Copy the data set with photos divided by their exposures."""
    if output.exists():
        raise SystemExit(f"{output}: exists; name another folder")
    names, found = exposures(data)
    shutil.copytree(data, output)
    for name, exposure in zip(names, found, strict=True):
        print(f"{name}: {np.exp(exposure):.3f}")
        with Image.open(data / "images" / name) as photo:
            pixels = np.asarray(photo.convert("RGB"), np.float64) * np.exp(-exposure)
        rounded = np.clip(pixels + 0.5, 0, 255).astype(np.uint8)
        Image.fromarray(rounded).save(output / "images" / name, quality=QUALITY, subsampling=0)


def score(data: Path, width: int, folder: Path) -> None:
    """Print mean PSNR, dB."""
    import clgs

    views = clgs.load_dataset(data, max_size=width).test
    scene = clgs.load_scene(folder / "scene.npz").dequantize()
    renderer = clgs.Renderer(clgs.Device(), scene)
    found = []
    for view in views:
        planes = view.photo.planes((0.0, 0.0, 0.0)), renderer.render(view.camera)
        truth, drawn = (np.moveaxis(np.asarray(one, np.float64), 0, -1) for one in planes)
        truth, drawn = truth / 255, np.clip(drawn, 0, 1)
        design = np.c_[drawn.reshape(-1, 3), np.ones(drawn.size // 3)]
        affine = np.linalg.lstsq(design, truth.reshape(-1, 3), rcond=None)[0]
        gain = (drawn * truth).sum() / np.square(drawn).sum()
        maps = drawn, gain * drawn, (design @ affine).reshape(truth.shape)
        errors = [np.square(np.clip(one, 0, 1) - truth).mean() for one in maps]
        found.append(-10 * np.log10(errors))
    print("{:.2f} as they are, {:.2f} by one number, {:.2f} affine".format(*np.mean(found, axis=0)))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["even", data, output]:
            even(Path(data), Path(output))
        case ["score", data, width, folder]:
            score(Path(data), int(width), Path(folder))
        case _:
            raise SystemExit(__doc__)
