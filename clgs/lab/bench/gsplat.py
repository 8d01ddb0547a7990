"""`clgs bench gsplat`: this device and gsplat on the same Gaussians, those of a rendered view.

gsplat is timed by CUDA's events. The calls follow the signatures of gsplat 1.5 (Ye et al., gsplat:
An Open-Source Library for Gaussian Splatting, JMLR 2025).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.errors import UsageError
from clgs.lab.bench.step import WARM_UP, synthetic_trainer, time_steps
from clgs.lab.figures import show_table, write_figures
from clgs.opencl.device import Device
from clgs.render.frame import Frame
from clgs.render.splat_meta import conics_of
from clgs.scene.camera import Camera

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Handover:
    """A view: what is drawn, and the picture that clgs makes of it.

    space: N Gaussians, float32: mean (N, 3), scale (N, 3), scene units; rotation (N, 4), unit
    quaternions w x y z; color (N, 3) and opacity (N,) in [0, 1]. screen: M Gaussians that touch the
    picture: mean (M, 2) pixels, pixel centres at +0.5; conic (M, 3), the inverse covariance as xx,
    xy, yy; radii (M, 2) int32, half-widths of the box that is looked at, pixels; depth (M,) camera
    z; color (M, 3) and opacity (M,). viewmat (4, 4) and intrinsics (3, 3): world to camera, and
    pixels; background (3,); image (H, W, 3). All others are float32.
    """

    space: dict[str, Floats]
    screen: dict[str, npt.NDArray[Any]]
    viewmat: Floats
    intrinsics: Floats
    background: Floats
    image: Floats

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.image.shape[1], self.image.shape[0]


def hand_over(device: Device, frame: Frame, camera: Camera) -> Handover:
    """Copy what ``frame`` was made of, without padding; ``camera``: of the frame."""
    load = device.download
    gaussians, projected = frame.gaussians, frame.projected
    names = ("mean", "scale", "rotation", "color", "opacity")
    every, extent = {name: load(getattr(gaussians, name)) for name in names}, load(projected.extent)
    there, drawn = every["opacity"] > 0, extent[:, 0] > 0
    screen = {
        "mean": load(projected.mean2d)[drawn],
        "conic": conics_of(load(projected.whitening)[drawn]),
        "radii": np.ceil(extent[drawn]).astype(np.int32),
        "depth": load(projected.depth)[drawn],
        "color": every["color"][drawn],
        "opacity": every["opacity"][drawn],
    }
    space = {name: array[there] for name, array in every.items()}
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3], viewmat[:3, 3] = camera.rotation, camera.translation
    intrinsics = np.array(
        [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32
    )
    image = np.ascontiguousarray(load(frame.image).transpose(1, 2, 0))
    return Handover(space, screen, viewmat, intrinsics, load(frame.view.background), image)


ROWS = {
    "lists of the tiles": ("tiles", "tiles"),
    "rasteriser forward": ("blend forward", "forward"),
    "rasteriser backward": ("blend backward", "backward"),
}
"""Rows of the table: the stage of `clgs bench step`, and the time of gsplat."""

STILL = 1e-12
"""Learning rate that leaves the Gaussians as they are."""

SSIM_SHARE = 0.2
"""The share of SSIM in the loss, as in 3DGS; the rest is L1."""

NEEDED = "it needs PyTorch with CUDA and gsplat: pip install 'clgs[gsplat]'"


@dataclass(frozen=True)
class PeerTimes:
    """Median milliseconds of gsplat.

    tiles: lists of the tiles; forward, backward: of its rasteriser alone, on projected Gaussians;
    step: projection, lists, rasteriser, loss, gradients and Adam on Gaussians in space; loss: what
    it is; difference: mean of |its picture - ours|; card and versions: what it ran on.
    """

    tiles: float
    forward: float
    backward: float
    step: float
    loss: str
    difference: float
    card: str
    versions: dict[str, str]


def run(
    gaussians: int,
    size: tuple[int, int],
    repeats: int,
    seed: int,
    device: str | None,
    json: Path | None,
) -> None:
    """Measure, print and, if asked, write JSON."""
    require_gsplat()
    opened = Device(device)
    trainer = synthetic_trainer(opened, gaussians, size, seed)
    view = hand_over(opened, trainer.render_next(), trainer.dataset.train[0].camera)
    ours, theirs = time_steps(trainer, repeats), time_gsplat(view, repeats, seed)
    pairs = {row: (ours.stages[name], getattr(theirs, time)) for row, (name, time) in ROWS.items()}
    pairs["whole step"] = ours.step, theirs.step
    rows = (
        (row, f"{own:.3f}", f"{other:.3f}", f"{own / other:.2f}")
        for row, (own, other) in pairs.items()
    )
    title = f"{opened.name}; gsplat on {theirs.card}; {ours.gaussians:,} Gaussians"
    show_table(title, ("median ms", "clgs", "gsplat", "ratio"), rows)
    print(f"loss of gsplat's step: {theirs.loss}; pictures differ by {theirs.difference:.1e}")
    stages = {name: ours.stages[name] for name, _ in ROWS.values()}
    record = {
        "clgs": {"step": ours.step, **stages},
        "gsplat": asdict(theirs),
        "gaussians": ours.gaussians,
    }
    write_figures(json, record, opened)


def require_gsplat() -> None:
    """See, before anything is measured, that gsplat can run.

    Raises:
        UsageError: it or PyTorch is missing, or there is no CUDA device.
    """
    try:
        import gsplat  # noqa: F401
        import torch
    except ImportError as error:
        raise UsageError(f"gsplat cannot be measured ({error}); {NEEDED}") from None
    if not torch.cuda.is_available():
        raise UsageError(f"gsplat cannot be measured (no CUDA device); {NEEDED}")


def has_gsplat() -> bool:
    """Whether gsplat can be measured here; PyTorch is loaded only if both are installed."""
    if not (find_spec("torch") and find_spec("gsplat")):
        return False
    try:
        require_gsplat()
    except UsageError:
        return False
    return True


def time_gsplat(view: Handover, repeats: int, seed: int) -> PeerTimes:
    """Time ``repeats`` passes of each kind; the photo is noise, drawn from ``seed``."""
    import gsplat
    import torch

    raster, (step, loss) = _Raster(view), _training_step(view, seed)
    forward, backward = _milliseconds(raster.forward, raster.backward, repeats)
    return PeerTimes(
        tiles=_milliseconds(raster.lists, lambda lists: None, repeats)[0],
        forward=forward,
        backward=backward,
        step=_milliseconds(step, lambda result: None, repeats)[0],
        loss=loss,
        difference=difference(raster.forward().detach().cpu().numpy(), view.image),
        card=torch.cuda.get_device_name(),
        versions={"torch": torch.__version__, "gsplat": gsplat.__version__},
    )


class _Raster:
    """gsplat's rasteriser on projected Gaussians."""

    def __init__(self, view: Handover) -> None:
        screen = view.screen
        self._size = view.size
        self._tiles = tuple(-(-edge // TILE_SIZE) for edge in view.size)
        self._radii, self._depth = _on_card(screen["radii"]), _on_card(screen["depth"])
        drawn = ("mean", "conic", "color", "opacity")
        self._drawn = [_on_card(screen[name]).requires_grad_() for name in drawn]
        self._background = _on_card(view.background)
        self._upstream = _on_card(np.ones(view.image.shape, np.float32))
        self._offsets, self._order = self.lists()

    def lists(self) -> tuple[Any, Any]:
        """Offsets of the tiles, and the Gaussians of all tiles."""
        import gsplat

        mean = self._drawn[0].detach()[None]
        _, keys, order = gsplat.isect_tiles(
            mean, self._radii[None], self._depth[None], TILE_SIZE, *self._tiles
        )
        return gsplat.isect_offset_encode(keys, 1, *self._tiles), order

    def forward(self) -> Any:
        """The picture (H, W, 3)."""
        import gsplat

        picture, _ = gsplat.rasterize_to_pixels(
            *(each[None] for each in self._drawn),
            *self._size,
            TILE_SIZE,
            self._offsets,
            self._order,
            backgrounds=self._background[None],
        )
        return picture[0]

    def backward(self, picture: Any) -> None:
        """Gradients by all that is drawn."""
        picture.backward(self._upstream)
        for each in self._drawn:
            each.grad = None


def _training_step(view: Handover, seed: int) -> tuple[Callable[[], None], str]:
    """A training step of gsplat on Gaussians in space, and what its loss is."""
    import gsplat
    import torch

    try:
        ssim = import_module("fused_ssim").fused_ssim  # which PyPI does not have
    except ImportError:
        ssim = None
    space = view.space
    opacity = np.clip(space["opacity"], 1e-4, 1 - 1e-4)
    logit = np.log(opacity / (1 - opacity))
    start = (space["mean"], space["rotation"], np.log(space["scale"]), logit, space["color"])
    parameters = [_on_card(each).requires_grad_() for each in start]
    adam = torch.optim.Adam(parameters, lr=STILL, fused=True)
    viewmat, intrinsics, background = map(
        _on_card, (view.viewmat, view.intrinsics, view.background)
    )
    photo = _on_card(np.random.default_rng(seed).random(view.image.shape, np.float32))

    def step() -> None:
        mean, rotation, log_scale, logit, color = parameters
        picture = gsplat.rasterization(
            mean,
            rotation,
            log_scale.exp(),
            logit.sigmoid(),
            color,
            viewmat[None],
            intrinsics[None],
            *view.size,
            backgrounds=background[None],
        )[0][0]
        loss = (picture - photo).abs().mean()
        if ssim is not None:
            pair = (each.permute(2, 0, 1)[None] for each in (picture, photo))
            loss = (1 - SSIM_SHARE) * loss + SSIM_SHARE * (1 - ssim(*pair))
        loss.backward()
        adam.step()
        adam.zero_grad(set_to_none=True)

    return step, "L1 and SSIM (fused_ssim)" if ssim else "L1 alone: fused_ssim is missing"


def _on_card(array: npt.NDArray[Any]) -> Any:
    import torch

    return torch.from_numpy(np.ascontiguousarray(array)).cuda()


def _milliseconds(
    first: Callable[[], Any], second: Callable[[Any], None], repeats: int
) -> tuple[float, float]:
    """Medians of both parts of work that is done again and again, by the card's clock."""
    import torch

    times = []
    for _ in range(WARM_UP + repeats):
        marks = [torch.cuda.Event(enable_timing=True) for _ in range(3)]
        marks[0].record()
        made = first()
        marks[1].record()
        second(made)
        marks[2].record()
        torch.cuda.synchronize()
        times.append((marks[0].elapsed_time(marks[1]), marks[1].elapsed_time(marks[2])))
    once, twice = zip(*times[WARM_UP:], strict=True)
    return median(once), median(twice)


def difference(one: npt.NDArray[np.floating], other: npt.NDArray[np.floating]) -> float:
    """The mean of |one - other|; pictures of values from 0 to 1."""
    return float(np.abs(one.astype(np.float64) - other).mean())
