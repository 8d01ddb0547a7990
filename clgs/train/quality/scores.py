"""Scores of a scene: its renders against photos, by PSNR and SSIM in the forms that papers report.

Of a photo with a mask, ``used`` (H, W) of 0 and 1, both pictures are black where it is 0, and only
the pixels where it is 1 count.

The files at the end are those that the 3DGS family's scripts and its compression survey read. PSNR
in both is ``psnr``: 8-bit pictures, one MSE over all channels, as the family's script computes it
from the PNG files of a model.
"""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.arguments import check_type
from clgs.constants import K_OFFSETS, SSIM_C1, SSIM_C2, SSIM_SIGMA, SSIM_WINDOW
from clgs.data.view import Color, View, with_photos
from clgs.errors import ClgsError, UsageError
from clgs.exports.pictures import Picture, picture_names
from clgs.files import append, atomic_write, atomic_write_all
from clgs.machine import processors, workers
from clgs.opencl.device import Device
from clgs.ops import cull, mlp, neural
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene, upload_view
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import QuantizedScene, SplatScene, drawable
from clgs.shapes import Shapes

BAND = 64
"""Rows that a thread compares at once: what is computed of them stays in a processor's cache."""

MOST_THREADS = 8
"""Each takes some megabytes."""


def to_8bit(image: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """The picture (H, W, 3) uint8 of a planar render (3, H, W).

    Clamped to [0, 1], times 255, rounded to the nearest integer, halves up: as
    ``torchvision.utils.save_image`` does, and exact for every k / 255 in float32.

    Raises:
        ClgsError: a pixel is not finite.
    """
    if not np.isfinite(image).all():
        raise ClgsError("render: a pixel is not finite; the scene holds broken numbers")
    levels = np.floor(np.clip(image, 0.0, 1.0) * 255.0 + 0.5)
    return np.ascontiguousarray(levels.astype(np.uint8).transpose(1, 2, 0))


Used = npt.NDArray[np.uint8] | None


def psnr_8bit(
    render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8], used: Used = None
) -> float:
    """-10 log10 of one MSE over all pixels and channels, data range 1, in dB.

    The literature's form. Both (H, W, 3) uint8; equal pictures give infinity.
    """
    shapes = Shapes()
    shapes.check("render", render, "H W 3", np.uint8)
    shapes.check("photo", photo, "H W 3", np.uint8)
    squared = render / 255.0
    for channel in range(3):  # without a second array of the picture's size
        squared[..., channel] -= photo[..., channel] / 255.0
    np.square(squared, out=squared)
    return float(_decibel(_chosen(squared, used).mean()))


def blackened(picture: npt.NDArray[np.uint8], used: Used) -> npt.NDArray[np.uint8]:
    """The picture (H, W, 3) uint8, black where it is masked."""
    return picture if used is None else picture * used[..., None]


def _chosen(values: npt.NDArray[np.float64], used: Used) -> npt.NDArray[np.float64]:
    """Select the ``values`` (H, W, C) that count; (N, C) if there is a mask."""
    return values if used is None or not used.any() else values[used != 0]


def psnr_channel_mean(
    render: npt.NDArray[np.floating], photo: npt.NDArray[np.uint8], used: Used = None
) -> float:
    """Mean of the three channels' PSNRs on the unclamped render, in dB.

    The form of the reference code. render (3, H, W) float; photo (H, W, 3) uint8. Never below
    the PSNR of the mean MSE over channels.
    """
    shapes = Shapes()
    shapes.check("photo", photo, "H W 3", np.uint8)
    shapes.check("render", render, "3 H W", render.dtype)
    squared = np.square(render.astype(np.float64) - (photo / 255.0).transpose(2, 0, 1))
    if used is not None and used.any():
        return float(np.mean(_decibel(squared[:, used != 0].mean(axis=1))))
    return float(np.mean(_decibel(squared.mean(axis=(1, 2)))))


def ssim(render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8], used: Used = None) -> float:
    """Mean structural similarity over pixels and channels (Wang et al. 2004).

    11x11 Gaussian window of sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, data range 1,
    float64. Both (H, W, 3) uint8.
    """
    return float(_chosen(ssim_map(blackened(render, used), blackened(photo, used)), used).mean())


def ssim_map(
    render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8]
) -> npt.NDArray[np.float64]:
    """SSIM of every pixel and channel, (H, W, 3); :func:`ssim` is its mean."""
    shapes = Shapes()
    shapes.check("render", render, "H W 3", np.uint8)
    shapes.check("photo", photo, "H W 3", np.uint8)
    result, reach = np.empty(render.shape), SSIM_WINDOW // 2

    def fill(top: int) -> None:
        first, last = max(top - reach, 0), top + BAND + reach
        x, y = render[first:last] / 255.0, photo[first:last] / 255.0
        mean_x, mean_y = _blur(x), _blur(y)
        variance_x = _blur(x * x) - mean_x**2
        variance_y = _blur(y * y) - mean_y**2
        covariance = _blur(x * y) - mean_x * mean_y
        numerator = (2.0 * mean_x * mean_y + SSIM_C1) * (2.0 * covariance + SSIM_C2)
        denominator = (mean_x**2 + mean_y**2 + SSIM_C1) * (variance_x + variance_y + SSIM_C2)
        band = numerator / denominator
        result[top : top + BAND] = band[top - first : top - first + BAND]

    with workers(min(processors(), MOST_THREADS)) as pool:
        list(pool.map(fill, range(0, len(render), BAND)))
    return result


def _decibel(mse: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        return np.asarray(-10.0 * np.log10(mse))


def _blur(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows and columns of (H, W, C) weighted by the window; zeros beyond the border."""
    from scipy.ndimage import correlate1d  # its 7 MiB would lie there while training

    distance = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    window = np.exp(-0.5 * (distance / SSIM_SIGMA) ** 2)
    window /= window.sum()
    for axis in (0, 1):
        image = correlate1d(image, window, axis=axis, mode="constant")
    return image


PROTOCOL = (
    "clgs-1: 8-bit pictures; psnr: one MSE over all pixels and channels; psnr_channel_mean: mean "
    "of the three channels' PSNRs, of the render before clamping and rounding; ssim: 11x11, "
    "sigma 1.5, zero padding"
)
LPIPS_PROTOCOL = "; lpips: VGG, version 0.1, pictures in [0, 1] not rescaled to [-1, 1]"

Measure = Callable[[Picture, Picture], float]
"""A score of a render and a photo, both (H, W, 3) uint8."""


@dataclass(frozen=True)
class ViewScore:
    """One view: its name and the scores; lpips is None if it was not measured."""

    name: str
    psnr: float
    psnr_channel_mean: float
    ssim: float
    seconds: float
    lpips: float | None = None

    def record(self) -> dict[str, Any]:
        """The scores, ready for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def evaluate_views(
    device: Device,
    scene: QuantizedScene | SplatScene,
    views: list[View],
    on_view: Callable[[str, Picture, Picture], None] = lambda name, render, photo: None,
    options: RenderOptions = DEFAULT,
    lpips: Measure | None = None,
) -> list[ViewScore]:
    """Score ``scene`` on ``views`` over the scene's own background.

    Args:
        device: where to render.
        scene: what to score.
        views: with their photos, of which no more than two are in memory at a time.
        on_view: called after each view with its name, render and photo, (H, W, 3) uint8, black
            where the photo is masked.
        options: of the renders.
        lpips: measured too if it is given, such as a :class:`clgs.train.quality.lpips.Lpips`.

    Raises:
        DataError: a photo is damaged.
        BudgetError: ``options.max_memory`` is too small for one of ``views``.
        TypeError: ``scene`` is neither a quantised scene nor one of splats, or ``views`` are no
            sequence of views.
    """
    if not isinstance(scene, SplatScene):
        remedy = "a run has it as .scene, clgs.load_scene reads one"
        check_type("scene", scene, QuantizedScene, remedy)
    check_type("views", views, Sequence, "such as [view], or .train and .test of a data set")
    for view in views:
        check_type("views", view, View, "a data set has them as .train and .test")
    renderer = Renderer(device, drawable(scene), options)
    renderer.check_budget((view.name, view.camera) for view in views)
    scores = []
    for view, planes in with_photos(views, scene.settings.background):
        start = time.perf_counter()
        image = renderer.render(view.camera)
        seconds = time.perf_counter() - start
        photo, used = np.ascontiguousarray(planes.transpose(1, 2, 0)), view.used()
        shown = blackened(to_8bit(image), used), blackened(photo, used)
        score = ViewScore(
            view.name,
            psnr_8bit(*shown, used),
            psnr_channel_mean(image, photo, used),
            ssim(*shown, used),
            seconds,
            lpips(*shown) if lpips else None,
        )
        scores.append(score)
        on_view(view.name, *shown)
    return scores


def mean_psnr(
    renderer: Renderer,
    views: Sequence[View],
    color: Color,
    on_view: Callable[[], None] = lambda: None,
) -> float:
    """Mean 8-bit PSNR of renders of ``views`` over the background ``color``.

    Raises:
        DataError: a photo is damaged.
        BudgetError: the renderer's budget is too small for one of ``views``.
    """
    renderer.check_budget((view.name, view.camera) for view in views)
    found = []
    for view, planes in with_photos(views, color):
        photo = np.ascontiguousarray(planes.transpose(1, 2, 0))
        found.append(psnr_8bit(to_8bit(renderer.render(view.camera)), photo, view.used()))
        on_view()
    return float(np.mean(found))


def summarize(
    scene: QuantizedScene | SplatScene, scores: list[ViewScore], nbytes: int | None
) -> dict[str, Any]:
    """Means over views with what a reader needs to compare them, ready for JSON."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(score, name) for score in scores]))

    with_lpips = all(score.lpips is not None for score in scores)
    return {
        "protocol": PROTOCOL + LPIPS_PROTOCOL * with_lpips,
        "views": len(scores),
        "psnr": mean("psnr"),
        "psnr_channel_mean": mean("psnr_channel_mean"),
        "ssim": mean("ssim"),
        **({"lpips": mean("lpips")} if with_lpips else {}),
        "bytes": nbytes,
        **(
            {"gaussians": len(scene.gaussians)}
            if isinstance(scene, SplatScene)
            else {"anchors": len(scene.anchors)}
        ),
        "render_seconds": mean("seconds"),
        "background": list(scene.settings.background),
    }


def count_drawn(
    device: Device,
    scene: QuantizedScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_camera: Callable[[], None] = lambda: None,
) -> int:
    """Slots of anchors that at least one of ``cameras`` sees with a positive opacity.

    An anchor has K slots, and the opacity of each depends on the direction of view: a slot that no
    camera ever sees with an opacity above 0 is no Gaussian. ``on_camera`` is called after each.
    """
    uploaded = upload_scene(device, scene.dequantize())
    drawn = np.zeros(len(scene.anchors), np.int32)
    for camera in cameras:
        reduced = camera.reduced(options.accuracy.downscale)
        view = upload_view(device, reduced, scene.settings)
        visible = cull.forward(device, uploaded.anchors, view.camera, options)
        inputs = mlp.Inputs(uploaded.anchors, uploaded.weights, view.camera)
        activations = mlp.opacities(device, inputs, visible.anchor, options, K_OFFSETS)
        slots, _ = neural.number(device, activations)
        anchor = device.download(activations.visible)
        seen = anchor >= 0
        drawn[anchor[seen]] |= device.download(slots)[seen]
        on_camera()
    return int((drawn[:, None] >> np.arange(K_OFFSETS) & 1).sum())


METRICS = {
    "SSIM": "ssim",
    "PSNR": "psnr",
    "LPIPS": "lpips",
    "PSNR channel mean": "psnr_channel_mean",
}
"""Names in the family's files, and ours; the last is no part of them, and marks the other form."""

HEADER = ("Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians")
"""Columns of the tables of results of the 3DGS compression survey, one file per scene."""

FILES = ("results.json", "per_view.json")


def write_inria(
    folder: Path, method: str, summary: dict[str, Any], scores: Sequence[ViewScore]
) -> None:
    """Write results.json and per_view.json, both or none, as metrics.py of graphdeco's 3DGS does.

    The first holds {method: {metric: mean}}, the second {method: {metric: {picture: score}}}, with
    the pictures under the names that ``clgs render`` gives them. A metric that was not measured is
    left out. ``method``: for example "ours_30000"; ``summary`` is from ``summarize``, ``scores``
    from ``evaluate_views``.
    """
    measured = {theirs: ours for theirs, ours in METRICS.items() if ours in summary}
    names = picture_names([score.name for score in scores])
    views = {
        theirs: {name: getattr(one, ours) for name, one in zip(names, scores, strict=True)}
        for theirs, ours in measured.items()
    }
    means = {theirs: summary[ours] for theirs, ours in measured.items()}
    folder.mkdir(parents=True, exist_ok=True)
    documents = zip(FILES, (means, views), strict=True)
    atomic_write_all(
        {
            folder / name: (json.dumps({method: value}, indent=1) + "\n").encode()
            for name, value in documents
        }
    )


def check_survey(path: Path) -> None:
    """Refuse a file that is there and is not a table of the survey.

    Raises:
        UsageError: its first line is another one.
    """
    if not path.exists() or not path.stat().st_size:
        return
    with path.open("rb") as file:
        first = file.readline(200).decode(errors="replace").strip()
    if first != ",".join(HEADER):
        raise UsageError(f"{path}: line 1 is not {','.join(HEADER)}; name another file")


def append_survey(path: Path, submethod: str, summary: dict[str, Any]) -> None:
    """Add a row to the table ``path``, all of it or nothing; a new table gets its header too.

    Numbers are written in full; LPIPS is empty if it was not measured. ``submethod``: what the
    survey appends to a method's name, "Baseline" for nothing; ``summary``: from ``summarize``, with
    "bytes" and "gaussians".

    Raises:
        UsageError: as :func:`check_survey`.
        OSError: ``path`` cannot be written.
    """
    check_survey(path)
    numbers = (summary.get(name, "") for name in ("psnr", "ssim", "lpips", "bytes", "gaussians"))
    row = _line([submethod, *numbers])
    if not path.exists() or not path.stat().st_size:
        atomic_write(path, _line(HEADER) + row)
    else:
        append(path, row if path.read_bytes().endswith(b"\n") else b"\n" + row)


def _line(cells: Sequence[Any]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()
