"""The plan of a run in blocks, made from its coarse scene: cuts, cameras, what each block draws.

A camera belongs to the blocks that make up more than LEAST_CONTRIBUTION of its picture; to one at
least. A block starts with its own anchors, those in its margin, and those that its cameras see.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.cluster.blocks.cuts import Cuts, bulk, cut_scene, long_axes
from clgs.constants import LEAST_CONTRIBUTION
from clgs.data.dataset import Dataset
from clgs.errors import DataError, UsageError
from clgs.files import make_folder, write_json
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.render.frame import upload_scene
from clgs.scene.anchors import take
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import save_scene
from clgs.train.quality.importance import LEAST_WEIGHT, view_weights
from clgs.train.run.run_folder import PLAN

START = "start.npz"
"""What a block starts with, in its folder."""

GROWTH = 4.0
"""A scene at full size is taken to need this many times the memory of the coarse one: a photo
has up to four times the pixels, and shows about four times the anchors."""

SPARE = 1.5
"""A block also holds its margin, and what its cameras see of others."""

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]


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
            "give fewer blocks"
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
