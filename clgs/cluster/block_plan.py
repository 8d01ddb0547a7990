"""The plan of a run in blocks, made from its coarse scene: cuts, cameras, what each block draws.

Cuts go along two axes of the grid of voxels. The first axis is cut into rows, and each row along
the second one into columns of its own, so that all blocks contribute about the same to the
pictures. Cuts are half-integers: every position, an integer of the grid, lies in exactly one block,
which owns the anchor.

A camera belongs to the blocks that make up more than LEAST_CONTRIBUTION of its picture; to one at
least. A block starts with its own anchors, those in its margin, and those that its cameras see.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import LEAST_CONTRIBUTION
from clgs.data.dataset import Dataset
from clgs.errors import DataError, UsageError
from clgs.files import make_folder, write_json
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.render.frame import upload_scene
from clgs.scene.anchors import take
from clgs.scene.region import Box
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import save_scene
from clgs.train.quality.importance import LEAST_WEIGHT, view_weights
from clgs.train.run.run_folder import PLAN

Integers = npt.NDArray[np.int32]
Floats = npt.NDArray[np.float64]

AUTO = "auto"

MOST_BLOCKS = 10_000

MARGIN = 0.1
"""Margin of a block, as a share of the mean length of blocks along that axis."""

BULK = (0.02, 0.98)
"""Shares of the contribution between which the length of a scene is measured: a few anchors are far
away."""


def parse_counts(text: str) -> tuple[int, int] | None:
    """(rows, columns) of NxM; None for AUTO.

    Raises:
        UsageError: neither, or a single block.
    """
    if text == AUTO:
        return None
    found = re.fullmatch(r"([0-9]{1,5})[x\u00d7]([0-9]{1,5})", text.strip().lower())
    rows, columns = (0, 0) if found is None else (int(found[1]), int(found[2]))
    if not rows * columns:
        raise UsageError(f"--blocks {text[:40]}: is not NxM, such as 2x2, nor {AUTO}")
    if rows * columns == 1:
        raise UsageError(f"--blocks {text}: is the whole scene; leave it out, or give more blocks")
    if rows * columns > MOST_BLOCKS:
        raise UsageError(f"--blocks {text}: at most {MOST_BLOCKS} blocks are possible")
    return rows, columns


@dataclass(frozen=True)
class Cuts:
    """Where a scene is cut, in integers of the grid of positions.

    axes: the axis across which rows follow each other, and that of columns; rows: cuts between
    rows; columns: of each row, the cuts between its columns; margin: around a block, along each of
    ``axes``.
    """

    axes: tuple[int, int]
    rows: tuple[float, ...]
    columns: tuple[tuple[float, ...], ...]
    margin: tuple[float, float]

    @property
    def names(self) -> list[str]:
        """ROW-COLUMN of every block; their order is that of all lists of blocks."""
        return [f"{row}-{column}" for row, column in self._places()]

    @property
    def counts(self) -> tuple[int, int]:
        """Rows, and columns of each."""
        return len(self.columns), len(self.columns[0]) + 1

    def owner(self, position: Integers) -> npt.NDArray[np.intp]:
        """The number of the block of each position (A, 3), (A,)."""
        first, second = self.axes
        row = np.searchsorted(self.rows, position[:, first])
        before, owner = 0, np.zeros(len(position), np.intp)
        for number, cuts in enumerate(self.columns):
            here = row == number
            owner[here] = before + np.searchsorted(cuts, position[here, second])
            before += len(cuts) + 1
        return owner

    def box(self, block: int, margin: bool) -> Box:
        """Block number ``block``, in integers of the grid, perhaps with its margin."""
        row, column = self._places()[block]
        lower, upper = [-math.inf] * 3, [math.inf] * 3
        places = ((self.rows, row), (self.columns[row], column))
        for axis, (cuts, place), around in zip(self.axes, places, self.margin, strict=True):
            edges = (-math.inf, *cuts, math.inf)
            lower[axis] = edges[place] - margin * around
            upper[axis] = edges[place + 1] + margin * around
        return Box((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]))

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {
            "axes": list(self.axes),
            "rows": list(self.rows),
            "columns": [list(cuts) for cuts in self.columns],
            "margin": list(self.margin),
        }

    @classmethod
    def restore(cls, record: Mapping[str, Any]) -> Cuts:
        """What gave ``record``; ValueError, TypeError or KeyError if nothing did."""
        first, second = map(int, record["axes"])
        across, along = map(float, record["margin"])
        columns = tuple(tuple(map(float, cuts)) for cuts in record["columns"])
        cuts = cls((first, second), tuple(map(float, record["rows"])), columns, (across, along))
        if len(columns) != len(cuts.rows) + 1 or {first, second} - {0, 1, 2}:
            raise ValueError("cuts and axes do not fit")
        return cuts

    def _places(self) -> list[tuple[int, int]]:
        """(row, column) of every block."""
        return [(r, c) for r, cuts in enumerate(self.columns) for c in range(len(cuts) + 1)]


def cut_scene(
    position: Integers, contribution: Floats, up: Floats, counts: tuple[int, int]
) -> Cuts:
    """Cuts of a scene into ``counts`` rows and columns of about equal contribution.

    Args:
        position: of the anchors, (A, 3), integers of their grid.
        contribution: of each anchor to all pictures, (A,), at least 0.
        up: (3,); the axis nearest to it is not cut.
        counts: rows across the longer of the others, and columns.

    Raises:
        UsageError: the anchors lie at too few places for these blocks.
    """
    weight = contribution + max(float(contribution.mean()), 1.0) * 1e-6
    first, second = long_axes(position, weight, up)
    lengths = [bulk(position[:, axis], weight) for axis in (first, second)]
    margin = [MARGIN * max(1.0, one / n) for one, n in zip(lengths, counts, strict=True)]
    rows = _cuts(position[:, first], weight, counts[0])
    row = np.searchsorted(rows, position[:, first])
    columns = tuple(
        _cuts(position[row == number, second], weight[row == number], counts[1])
        for number in range(counts[0])
    )
    return Cuts((first, second), rows, columns, (margin[0], margin[1]))


def long_axes(position: Integers, weight: Floats, up: Floats) -> tuple[int, int]:
    """The axes other than the one nearest to ``up``, the one along which anchors spread first."""
    flat = [axis for axis in range(3) if axis != int(np.argmax(np.abs(up)))]
    first, second = sorted(flat, key=lambda axis: -bulk(position[:, axis], weight))
    return first, second


def bulk(coordinate: Integers, weight: Floats) -> float:
    """The length that holds most of the weight (A,) along one axis, in cells."""
    order = np.argsort(coordinate, kind="stable")
    total = np.cumsum(weight[order])
    last = len(order) - 1
    low, high = (min(last, int(np.searchsorted(total, part * total[-1]))) for part in BULK)
    return float(coordinate[order[high]]) - float(coordinate[order[low]])


def _cuts(coordinate: Integers, weight: Floats, parts: int) -> tuple[float, ...]:
    """The ``parts`` - 1 half-integers between parts of about equal weight, none of them empty."""
    places, index = np.unique(coordinate, return_inverse=True)
    if len(places) < parts:
        raise UsageError(
            f"--blocks: the anchors lie at {len(places)} places along an axis, too few for "
            f"{parts} blocks; give fewer"
        )
    total = np.cumsum(np.bincount(index, weight))
    ends, last = [], -1
    for part in range(1, parts):
        wanted = int(np.searchsorted(total, total[-1] * part / parts))
        last = min(max(wanted, last + 1), len(places) - 1 - (parts - part))
        ends.append(float(places[last]) + 0.5)
    return tuple(ends)


START = "start.npz"
"""What a block starts with, in its folder."""

GROWTH = 4.0
"""A scene at full size is taken to need this many times the memory of the coarse one: a photo
has up to four times the pixels, and shows about four times the anchors."""

SPARE = 1.5
"""A block also holds its margin, and what its cameras see of others."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Plan:
    """Cuts, and the names of the training and of the held-out photos of every block."""

    cuts: Cuts
    train: dict[str, list[str]]
    test: dict[str, list[str]]

    def write(self, folder: Path) -> None:
        """Write PLAN into ``folder``, in which each block has one of its own."""
        record = {"cuts": self.cuts.record(), "train": self.train, "test": self.test}
        write_json(folder / PLAN, record)


def read_plan(folder: Path) -> Plan | None:
    """The plan in ``folder``; None if there is none.

    Raises:
        DataError: it is damaged.
    """
    path = folder / PLAN
    if not path.is_file():
        return None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        plan = Plan(Cuts.restore(record["cuts"]), dict(record["train"]), dict(record["test"]))
        if set(plan.train) != set(plan.cuts.names) or set(plan.test) != set(plan.cuts.names):
            raise ValueError("its blocks and its photos do not fit")
        return plan
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise DataError(f"{path}: is damaged ({error}); start again by --overwrite") from None


@dataclass(frozen=True)
class Pictures:
    """What A anchors contribute to the pictures of the training and the held-out photos.

    seen: of each picture, the anchors that it shows and their weights in pixels; pixels: its size;
    names: of the photos, the training ones first; trained: how many these are.
    """

    seen: list[tuple[npt.NDArray[np.intp], Floats]]
    pixels: list[int]
    names: list[str]
    trained: int

    def contribution(self, anchors: int) -> Floats:
        """What each of ``anchors`` contributes to the training photos, in pixels, (anchors,)."""
        total = np.zeros(anchors)
        for rows, weight in self.seen[: self.trained]:
            total[rows] += weight
        return total

    def members(self, owner: npt.NDArray[np.intp], blocks: int) -> Mask:
        """Whether each picture belongs to each block, (pictures, blocks); ``owner`` (A,)."""
        found = np.zeros((len(self.seen), blocks), np.bool_)
        for picture, (rows, weight) in enumerate(self.seen):
            share = np.bincount(owner[rows], weight, blocks) / self.pixels[picture]
            found[picture] = share > LEAST_CONTRIBUTION
            found[picture, int(np.argmax(share))] |= bool(share.any())
        return found

    def shown(self, pictures: Mask, anchors: int) -> Mask:
        """Whether each of ``anchors`` shows in one of the chosen ``pictures``, (anchors,)."""
        found = np.zeros(anchors, np.bool_)
        for picture in np.flatnonzero(pictures):
            found[self.seen[picture][0]] = True
        return found


def look(
    device: Device,
    scene: QuantizedScene,
    dataset: Dataset,
    options: RenderOptions,
    on_render: Callable[[], None],
) -> Pictures:
    """Draw ``scene`` for every camera of ``dataset``; ``on_render`` is called after each."""
    views = dataset.train + dataset.test
    cameras = [view.camera for view in views]
    uploaded = upload_scene(device, scene.dequantize())
    seen = []
    none = [None] * len(views)
    for weight, _ in view_weights(device, uploaded, scene.settings, cameras, none, options):
        rows = np.flatnonzero(weight >= LEAST_WEIGHT)
        seen.append((rows, weight[rows]))
        on_render()
    pixels = [camera.width * camera.height for camera in cameras]
    return Pictures(seen, pixels, [view.name for view in views], len(dataset.train))


def make_plan(
    folder: Path, scene: QuantizedScene, dataset: Dataset, seen: Pictures, counts: tuple[int, int]
) -> Plan:
    """Cut ``scene``; ``folder`` receives the plan last, and before it what each block starts with.

    Raises:
        UsageError: the scene cannot be cut so, or a block has no camera.
    """
    position = scene.anchors.position
    cuts = cut_scene(position, seen.contribution(len(position)), up_of(dataset), counts)
    owner, names = cuts.owner(position), cuts.names
    members = seen.members(owner, len(names))
    chosen: dict[str, dict[str, list[str]]] = {"train": {}, "test": {}}
    for number, name in enumerate(names):
        here = np.flatnonzero(members[:, number])
        chosen["train"][name] = [seen.names[i] for i in here if i < seen.trained]
        chosen["test"][name] = [seen.names[i] for i in here if i >= seen.trained]
    empty = [name for name, photos in chosen["train"].items() if not photos]
    if empty:
        share = f"{100 * LEAST_CONTRIBUTION:g} %"
        raise UsageError(
            f"--blocks: block {empty[0]} has no camera, as it is below {share} of every photo; "
            "give fewer blocks, with --resume"
        )
    for number, name in enumerate(names):
        kept = seen.shown(members[:, number], len(position))
        kept |= cuts.box(number, margin=True).holds(position)
        start = replace(scene, anchors=take(scene.anchors, kept))
        make_folder(folder / name)
        save_scene(folder / name / START, start)
    plan = Plan(cuts, chosen["train"], chosen["test"])
    plan.write(folder)
    return plan


def up_of(dataset: Dataset) -> Floats:
    """The mean direction (3,) that is up in the training photos."""
    return np.asarray(-np.mean([view.camera.rotation[1] for view in dataset.train], axis=0))


def counts_for_memory(
    scene: QuantizedScene,
    contribution: Floats,
    up: Floats,
    coarse: tuple[int, int],
    worker: int,
) -> tuple[int, int]:
    """The rows and columns of the least number of blocks, 2 at least, that workers have room for.

    Args:
        scene: the coarse one.
        contribution: of its anchors, (A,).
        up: as of :func:`up_of`.
        coarse: bytes of a process before it trained that scene, and at most while it did.
        worker: bytes that a worker may take.

    Raises:
        UsageError: a worker has no room for any block.
    """
    idle, peak = coarse
    room = worker - idle
    if room <= 0:
        raise UsageError(
            f"--blocks auto: a worker has {worker >> 20} MiB, and needs {idle >> 20} before it "
            "trains; start fewer on each machine, or give NxM"
        )
    blocks = max(2, math.ceil(SPARE * GROWTH * max(0, peak - idle) / room))
    position = scene.anchors.position
    lengths = [
        bulk(position[:, axis], contribution) for axis in long_axes(position, contribution, up)
    ]
    across = max(1, round(math.sqrt(blocks * lengths[1] / max(lengths[0], 1.0))))
    return math.ceil(blocks / across), across
