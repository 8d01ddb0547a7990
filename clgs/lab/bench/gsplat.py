"""`clgs bench gsplat`: this device and gsplat on the same Gaussians.

gsplat is timed by CUDA's events. The calls follow the signatures of gsplat 1.5 (Ye et al., gsplat:
An Open-Source Library for Gaussian Splatting, JMLR 2025).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import TILE_SIZE
from clgs.errors import UsageError
from clgs.files import check_target
from clgs.lab.bench.handover import Handover, hand_over
from clgs.lab.bench.step import WARM_UP, synthetic_trainer, time_steps
from clgs.lab.facts import show_table, write_figures
from clgs.opencl.device import Device

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


def run(args: argparse.Namespace) -> int:
    """Measure, print and, if asked, write JSON; exit code 0."""
    if args.json:
        check_target(args.json)
    require_gsplat()
    device = Device(args.device)
    trainer = synthetic_trainer(device, args.gaussians, args.size, args.seed)
    view = hand_over(device, trainer.render_next(), trainer.dataset.train[0].camera)
    ours, theirs = time_steps(trainer, args.repeats), time_gsplat(view, args.repeats, args.seed)
    pairs = {row: (ours.stages[name], getattr(theirs, time)) for row, (name, time) in ROWS.items()}
    pairs["whole step"] = ours.step, theirs.step
    rows = (
        (row, f"{own:.3f}", f"{other:.3f}", f"{own / other:.2f}")
        for row, (own, other) in pairs.items()
    )
    title = f"{device.name}; gsplat on {theirs.card}; {ours.gaussians:,} Gaussians"
    show_table(title, ("median ms", "clgs", "gsplat", "ratio"), rows)
    print(f"loss of gsplat's step: {theirs.loss}; pictures differ by {theirs.difference:.1e}")
    stages = {name: ours.stages[name] for name, _ in ROWS.values()}
    record = {
        "clgs": {"step": ours.step, **stages},
        "gsplat": asdict(theirs),
        "gaussians": ours.gaussians,
    }
    write_figures(args.json, record, device)
    return 0


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

    raster = _Raster(torch, gsplat, view)
    forward = _milliseconds(torch, raster.forward, repeats)
    _, backward = zip(*_split(torch, raster.forward, raster.backward, repeats), strict=True)
    whole = _Step(torch, gsplat, view, seed)
    return PeerTimes(
        tiles=_milliseconds(torch, raster.lists, repeats),
        forward=forward,
        backward=median(backward),
        step=_milliseconds(torch, whole.run, repeats),
        loss=whole.loss,
        difference=difference(raster.forward().detach().cpu().numpy(), view.image),
        card=torch.cuda.get_device_name(),
        versions={"torch": torch.__version__, "gsplat": gsplat.__version__},
    )


class _Raster:
    """gsplat's rasteriser on projected Gaussians."""

    def __init__(self, torch: Any, gsplat: Any, view: Handover) -> None:
        screen = view.screen
        self._gsplat, self._size = gsplat, view.size
        self._tiles = tuple(-(-edge // TILE_SIZE) for edge in view.size)
        load = _loader(torch)
        self._radii, self._depth = load(screen.radii), load(screen.depth)
        drawn = (screen.mean, screen.conic, screen.color, screen.opacity)
        self._drawn = [load(each).requires_grad_() for each in drawn]
        self._background = load(view.background)
        self._upstream = load(np.ones((*view.image.shape,), np.float32))
        self._offsets, self._order = self.lists()

    def lists(self) -> tuple[Any, Any]:
        """Offsets of the tiles, and the Gaussians of all tiles."""
        mean = self._drawn[0].detach()[None]
        _, keys, order = self._gsplat.isect_tiles(
            mean, self._radii[None], self._depth[None], TILE_SIZE, *self._tiles
        )
        return self._gsplat.isect_offset_encode(keys, 1, *self._tiles), order

    def forward(self) -> Any:
        """The picture (H, W, 3)."""
        picture, _ = self._gsplat.rasterize_to_pixels(
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


class _Step:
    """A training step of gsplat on Gaussians in space."""

    def __init__(self, torch: Any, gsplat: Any, view: Handover, seed: int) -> None:
        load, space = _loader(torch), view.space
        self._gsplat, self._size = gsplat, view.size
        opacity = np.clip(space.opacity, 1e-4, 1 - 1e-4)
        start = (
            space.mean,
            space.rotation,
            np.log(space.scale),
            np.log(opacity / (1 - opacity)),
            space.color,
        )
        self._parameters = [load(each).requires_grad_() for each in start]
        self._adam = torch.optim.Adam(self._parameters, lr=STILL, fused=True)
        camera = (view.viewmat, view.intrinsics, view.background)
        self._viewmat, self._intrinsics, self._background = map(load, camera)
        self._photo = load(np.random.default_rng(seed).random(view.image.shape, np.float32))
        self._ssim = _fused_ssim()
        self.loss = "L1 and SSIM (fused_ssim)" if self._ssim else "L1 alone: fused_ssim is missing"

    def run(self) -> None:
        """One step."""
        mean, rotation, log_scale, logit, color = self._parameters
        picture, _, _ = self._gsplat.rasterization(
            mean,
            rotation,
            log_scale.exp(),
            logit.sigmoid(),
            color,
            self._viewmat[None],
            self._intrinsics[None],
            *self._size,
            backgrounds=self._background[None],
        )
        self._loss_of(picture[0]).backward()
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def _loss_of(self, picture: Any) -> Any:
        difference = (picture - self._photo).abs().mean()
        if self._ssim is None:
            return difference
        pair = (each.permute(2, 0, 1)[None] for each in (picture, self._photo))
        return (1 - SSIM_SHARE) * difference + SSIM_SHARE * (1 - self._ssim(*pair))


def _fused_ssim() -> Any:
    """The function of fused-ssim, which PyPI does not have; None if it is not installed."""
    try:
        return import_module("fused_ssim").fused_ssim
    except ImportError:
        return None


def _loader(torch: Any) -> Callable[[npt.NDArray[Any]], Any]:
    return lambda array: torch.from_numpy(np.ascontiguousarray(array)).cuda()


def _milliseconds(torch: Any, work: Callable[[], Any], repeats: int) -> float:
    return median(first for first, _ in _split(torch, work, lambda _: None, repeats))


def _split(
    torch: Any, first: Callable[[], Any], second: Callable[[Any], Any], repeats: int
) -> list[tuple[float, float]]:
    """Milliseconds of both parts of work that is done again and again, by the card's clock."""
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
    return times[WARM_UP:]


def difference(one: npt.NDArray[np.floating], other: npt.NDArray[np.floating]) -> float:
    """The mean of |one - other|; pictures of values from 0 to 1."""
    return float(np.abs(one.astype(np.float64) - other).mean())
