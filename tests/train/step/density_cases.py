"""Small sets of anchors whose rows can be followed through growing, pruning and merging."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.opencl.device import Device
from clgs.ops.density import Statistics
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import AnchorSet
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import HostRows, Moments, Parameters
from clgs.train.state.voxel_grid import position_integers
from clgs.train.step import grow_and_prune

VOXEL = 0.5
CONFIG = TrainConfig(voxel=VOXEL, growth_threshold=0.25)


class Draws:
    """Stands in for a generator: hands out given arrays, or 0.99 for every draw."""

    def __init__(self, *arrays: list[float]) -> None:
        self.arrays = list(arrays)
        self.sizes: list[int] = []

    def random(self, size: int) -> npt.NDArray[np.float64]:
        self.sizes.append(size)
        return np.array(self.arrays.pop(0)) if self.arrays else np.full(size, 0.99)


def state_at(integers: Any) -> HostRows:
    """Anchors in the given voxels; every row of every array holds its row number plus 1."""
    position = (np.array(integers, np.float64) * VOXEL).astype(np.float32)
    count = len(position)
    number = np.arange(1, count + 1)

    def numbered(*shape: int, dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
        return np.broadcast_to(number.reshape(-1, *[1] * len(shape)), (count, *shape)).astype(dtype)

    anchors = AnchorSet(
        position,
        np.zeros((count, K_OFFSETS, 3), np.float32),
        numbered(FEATURE_DIM),
        np.zeros((count, 6), np.float32),
    )
    statistics = Statistics(
        numbered(),
        np.zeros(count, np.int32),
        np.zeros((count, K_OFFSETS), np.float32),
        np.zeros((count, K_OFFSETS), np.int32),
    )
    shapes = {"offset": (K_OFFSETS, 3), "feature": (FEATURE_DIM,), "scaling": (6,)}
    moments = {
        name: Moments(numbered(*shape), 10 * numbered(*shape)) for name, shape in shapes.items()
    }
    return HostRows(anchors, statistics, moments)


def ask(state: HostRows, row: int, slot: int, voxels: tuple[float, ...], mean: float) -> None:
    """Put a slot this many voxels from its anchor and let it have seen a mean gradient."""
    state.anchors.offset[row, slot] = np.array(voxels) * VOXEL
    state.statistics.gradient_count[row, slot] = 64
    state.statistics.gradient_sum[row, slot] = 64 * mean


def integers_of(state: HostRows) -> list[tuple[int, ...]]:
    return [tuple(row) for row in position_integers(state.anchors.position, 1 / VOXEL).tolist()]


def arrays_of(state: HostRows) -> dict[str, npt.NDArray[Any]]:
    found = {**dict(state.anchors.items()), **dict(state.statistics.items())}
    for name, moments in state.moments.items():
        found |= {f"{which} {name}": array for which, array in moments.items()}
    return found


def assert_same(first: HostRows, second: HostRows) -> None:
    for (name, one), other in zip(
        arrays_of(first).items(), arrays_of(second).values(), strict=True
    ):
        np.testing.assert_array_equal(one, other, err_msg=name)


def assert_rows(state: HostRows, numbers: list[int]) -> None:
    """The rows are those that :func:`state_at` numbered so, in every array; 0 is a new row."""
    for name, moments in state.moments.items():
        for moment, factor in ((moments.first, 1), (moments.second, 10)):
            flat = moment.reshape(len(moment), -1)
            assert (flat == factor * np.array(numbers)[:, None]).all(), name
    for array in arrays_of(state).values():
        assert len(array) == len(numbers)


def random_state(seed: int, count: int = 30, spread: int = 25) -> HostRows:
    rng = np.random.default_rng(seed)
    integers = np.unique(rng.integers(-spread, spread, (count, 3)), axis=0)
    state = state_at(integers)
    count = len(integers)
    state.anchors.offset[:] = rng.normal(0, 4, state.anchors.offset.shape)
    state.anchors.feature[:] = rng.normal(0, 1, state.anchors.feature.shape)
    state.anchors.scaling[:] = rng.normal(0, 0.4, state.anchors.scaling.shape)
    state.statistics.gradient_count[:] = rng.integers(0, 90, (count, K_OFFSETS))
    state.statistics.gradient_sum[:] = rng.uniform(0, 30, (count, K_OFFSETS))
    state.statistics.visits[:] = rng.integers(0, 160, count)
    state.statistics.opacity_sum[:] = rng.uniform(0, 1, count)
    return state


def on_device(device: Device, state: HostRows) -> tuple[Parameters, npt.NDArray[np.float32]]:
    """The same on the device, with a copy of the positions; the MLPs have no weights."""
    scene = DeviceScene(state.anchors.map(device.upload), device.zeros((1,)))
    moments = {name: one.map(device.upload) for name, one in state.moments.items()}
    statistics = state.statistics.map(device.upload)
    return Parameters(scene, moments, statistics), state.anchors.position.copy()


def take_back(
    device: Device, state: HostRows, there: Parameters, position: npt.NDArray[np.float32]
) -> None:
    """Make ``state`` what is ``there``, without the rows that are hidden."""
    hidden = grow_and_prune.count_hidden(position)
    rows = grow_and_prune.compacted(device, replace(there, hidden=hidden)).download(device)
    vars(state).update(vars(rows))
    np.testing.assert_array_equal(state.anchors.position, position[~np.isnan(position[:, 0])])


def mask_prune(
    device: Device, state: HostRows, visible: npt.NDArray[np.int32], opacity: npt.NDArray[Any]
) -> int:
    """How many anchors go, of which ``opacity`` (V, K) shows nothing; ``state`` changes."""
    (there, _), before = on_device(device, state), len(state.anchors)
    output = device.upload(np.ascontiguousarray(opacity.T, np.float32))
    position = grow_and_prune.mask_prune(device, there, device.upload(visible), output)
    take_back(device, state, there, position)
    return before - len(state.anchors)


def grow(device: Device, state: HostRows, config: TrainConfig, rng: Any) -> int:
    """How many anchors come; ``state`` changes."""
    there, position = on_device(device, state)
    there, grown = grow_and_prune.grow(device, config, there, position, rng)
    take_back(device, state, there, grown)
    return len(grown) - len(position)


def prune(device: Device, state: HostRows, config: TrainConfig) -> int:
    """How many anchors go; ``state`` changes."""
    there, position = on_device(device, state)
    count = grow_and_prune.prune(device, config, there, position)
    take_back(device, state, there, position)
    return count
