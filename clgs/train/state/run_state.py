"""The state of a run: everything that its next steps depend on.

A step reads the record and changes its device arrays, growing and rounds give it other anchors, and
a checkpoint saves it. Nothing else that changes during a run has an effect on its results. The
trained parameters are on the device, with all that goes with each of their rows.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.data.view import View
from clgs.errors import ClgsError
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, density, exposure
from clgs.ops.density import DeviceStatistics, Statistics
from clgs.ops.rate import Rate
from clgs.options import BACKGROUNDS
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, AnchorSet, QuantizationScales, take
from clgs.scene.camera import photo_range
from clgs.scene.mlps import Mlps
from clgs.scene.scene import RenderSettings
from clgs.train.config import TrainConfig
from clgs.train.config.settings import PAPER_Q
from clgs.train.quality.importance import Sensitivity

Moments = adam.Moments[npt.NDArray[np.float32]]

ANCHOR_GROUPS = tuple(name for name in FIELDS if name != "position")
"""Anchor tensors that Adam updates; positions have learning rate 0."""

NOTHING_LEFT = (
    "pruning left no anchors: nothing is opaque in any view; "
    "check the images and poses, or lower the learning rates"
)


@dataclass(frozen=True)
class Parameters:
    """Anchors and MLP weights on the device, their Adam moments, and the anchors' statistics.

    ``moments`` holds those of ANCHOR_GROUPS and of "weights", shaped like these tensors.
    ``statistics`` decide about growing and pruning. ``hidden`` anchors have a position of NaN and
    do not count any more; their rows are left out later.
    """

    scene: DeviceScene
    moments: dict[str, adam.DeviceMoments]
    statistics: DeviceStatistics
    hidden: int = 0

    @property
    def rows(self) -> int:
        """The number of rows, including those of hidden anchors."""
        return len(self.scene.anchors)

    @property
    def count(self) -> int:
        """The number of anchors."""
        return self.rows - self.hidden

    def download_anchors(self, device: Device) -> AnchorSet:
        """Copy the anchors that are not hidden to the host."""
        anchors = self.scene.anchors.map(device.download)
        return take(anchors, ~np.isnan(anchors.position[:, 0])) if self.hidden else anchors

    def download(self, device: Device) -> HostRows:
        """Copy everything that has a row per anchor to the host; no anchor may be hidden."""
        assert not self.hidden
        device.release_unused()
        return HostRows(
            anchors=self.scene.anchors.map(device.download),
            statistics=self.statistics.map(device.download),
            moments={name: self.moments[name].map(device.download) for name in ANCHOR_GROUPS},
        )

    def with_rows(self, device: Device, rows: HostRows) -> Parameters:
        """The parameters with these rows in place of theirs; the MLP arrays stay where they are."""
        statistics = rows.statistics.map(device.upload)
        moments = {name: rows.moments[name].map(device.upload) for name in ANCHOR_GROUPS}
        scene = replace(self.scene, anchors=rows.anchors.map(device.upload))
        return Parameters(scene, {**self.moments, **moments}, statistics)


@dataclass
class HostRows:
    """Everything that has a row per anchor, on the host: anchors, statistics and Adam moments.

    ``moments`` holds those of ANCHOR_GROUPS, shaped like these tensors.
    """

    anchors: AnchorSet
    statistics: Statistics[npt.NDArray[Any]]
    moments: dict[str, Moments]

    def keep(self, kept: npt.NDArray[np.bool_]) -> int:
        """Drop the rows where ``kept`` (A,) is false; return how many.

        Raises:
            ClgsError: nothing is left.
        """
        rows = np.flatnonzero(kept)
        if not len(rows):
            raise ClgsError(NOTHING_LEFT)
        if len(rows) < len(kept):
            self.anchors = self.anchors.map(lambda array: array.take(rows, axis=0))
            self.statistics = self.statistics.map(lambda array: array.take(rows, axis=0))
            self.moments = {
                name: moments.map(lambda array: array.take(rows, axis=0))
                for name, moments in self.moments.items()
            }
        return len(kept) - len(rows)


def new_parameters(device: Device, anchors: AnchorSet, mlps: Mlps) -> Parameters:
    """Upload parameters; their moments and statistics are zero."""
    scene = DeviceScene(anchors.map(device.upload), device.upload(mlps.flat))
    moments = {
        name: adam.zero_moments(device, array)
        for name, array in scene.items()
        if name != "position"
    }
    return Parameters(scene, moments, density.zeros(device, len(anchors)))


@dataclass(frozen=True, eq=False)
class RateTables:
    """The rate of each of ANCHOR_GROUPS at step ``step``, and the number of anchors then."""

    step: int
    rates: dict[str, Rate]
    anchors: int

    @property
    def bits(self) -> float:
        """The estimated bits per anchor."""
        return sum(one.bits for one in self.rates.values())


@dataclass
class RateState:
    """What decides about the size of the file.

    scales: integers per unit that attributes are rounded to; price: of a bit, in units of the loss,
    0 until the first round; tables: the newest ones of the rate proxy, the last one made last.
    """

    scales: QuantizationScales
    price: float = 0.0
    tables: list[RateTables] = field(default_factory=list)


@dataclass
class ExposureMaps:
    """Affine maps of colors (P, 3, 4) float32, one per training photo, with their Adam moments."""

    maps: DeviceArray
    moments: adam.DeviceMoments


@dataclass
class Means:
    """Means of parameters after the steps that follow number ``begin``, by name of the tensor."""

    begin: int = 0
    tensors: dict[str, DeviceArray] = field(default_factory=dict)


class ViewOrder:
    """Deals every view once per epoch, in a new random order each time (paper)."""

    def __init__(self, count: int, seed: int) -> None:
        """Deal the views 0 .. ``count`` - 1; the same seed gives the same order."""
        if count < 1:
            raise ValueError("count: there is no view to deal")
        self._count = count
        self._rng = np.random.default_rng(seed)
        self._order: list[int] = []
        self._next = 0

    def take(self, count: int) -> list[int]:
        """The numbers of the next ``count`` views, which are taken; no two are the same.

        A batch that ends in a new epoch begins that one with views that it has not yet.
        """
        if count > self._count:
            raise ValueError(f"count: {count} different views of {self._count}")
        taken = self._order[self._next : self._next + count]
        self._next += len(taken)
        if missing := count - len(taken):
            order = self._rng.permutation(self._count).tolist()
            head = [view for view in order if view not in taken][:missing]
            self._order = head + [view for view in order if view not in head]
            self._next = missing
            taken += head
        return taken

    def upcoming(self, count: int) -> list[int]:
        """The numbers of the next ``count`` views, which are not taken; at most one epoch ahead."""
        coming = self._order[self._next : self._next + count]
        if len(coming) < count:
            coming += copy.deepcopy(self._rng).permutation(self._count).tolist()
        return coming[:count]

    def record(self) -> dict[str, Any]:
        """Everything that :meth:`restore` needs to continue exactly, ready for JSON."""
        return {
            "count": self._count,
            "order": list(self._order),
            "next": self._next,
            "rng": self._rng.bit_generator.state,
        }

    @classmethod
    def restore(cls, record: dict[str, Any]) -> ViewOrder:
        """The order that gave ``record``."""
        views = cls(record["count"], 0)
        views._rng.bit_generator.state = record["rng"]
        views._order = list(record["order"])
        views._next = record["next"]
        return views


@dataclass
class RunState:
    """The state of a run after step number ``step``.

    rng: what growing and random backgrounds draw from; exposures: None if they are not learned;
    known: what rounds have found out about the anchors, None before the first round at integers;
    means: which the parameters will take;
    merged: anchors that were merged when positions moved to a coarser grid; begun: the step after
    which all moments of Adam were zero, 0 but for scenes that go on without theirs.
    """

    parameters: Parameters
    rate: RateState
    exposures: ExposureMaps | None
    rng: np.random.Generator
    views: ViewOrder
    known: Sensitivity | None = None
    means: Means = field(default_factory=Means)
    merged: int = 0
    step: int = 0
    begun: int = 0


def new_state(
    device: Device,
    config: TrainConfig,
    photos: int,
    anchors: AnchorSet,
    mlps: Mlps,
    rng: np.random.Generator,
) -> RunState:
    """The state before the first step, for ``photos`` training views, on ``device``."""
    q = {name: getattr(config, name) or paper for name, paper in PAPER_Q.items()}
    scales = QuantizationScales(config.position_q, q["offset_q"], q["feature_q"], q["scaling_q"])
    return RunState(
        parameters=new_parameters(device, anchors, mlps),
        rate=RateState(scales),
        exposures=new_exposures(device, config, photos),
        rng=rng,
        views=ViewOrder(photos, config.seed),
    )


def new_exposures(device: Device, config: TrainConfig, photos: int) -> ExposureMaps | None:
    """Maps of ``photos`` photos that change nothing yet; None if ``config`` asks for none."""
    if not config.exposure:
        return None
    maps = exposure.identity(device, photos)
    return ExposureMaps(maps, adam.zero_moments(device, maps))


def render_settings(config: TrainConfig, views: Sequence[View] = ()) -> RenderSettings:
    """How renders of a scene that learns from ``views`` are made: no background is random."""
    background = BACKGROUNDS.get(config.background, BACKGROUNDS["black"])
    photos = photo_range([view.camera for view in views])
    return RenderSettings(background=background, near=config.near, photos=photos)
