"""The encoder's search for the model of attribute channels (codec_c/FORMAT.md on attributes).

Choices are made on a sample of rows by exact cost, tables from all rows. All decisions rest on
integers, or on floating-point operations that IEEE 754 defines to the bit, so that every machine
writes the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.attributes.model import (
    CELLS,
    MAX_GAIN,
    MAX_WEIGHT,
    NEAR,
    TABLE,
    TAPS,
    Ints,
    Models,
    empty_model,
)
from clgs.codec.attributes.near import NearRows, find_near
from clgs.codec.attributes.taps import find_taps

SAMPLE_BLOCKS, SAMPLE_ROWS = 8, 2048
LONG_ROWS = 2048
"""Chunks of at least this many rows have eight lanes, shorter ones have one."""

TAP_COST = 24 << 16
"""Bits of a term in the header, in 2^-16 bits."""

TRIAL_GAIN = 64
"""Gain while predictions are tried: levels of the own column only."""

MAGNITUDE = 256
"""Gains make the mean magnitude of a channel a 16th of this."""

WEIGHT_OF_OWN, WEIGHT_OF_ROW, WEIGHT_BESIDE = 1365, 4096, 2048
"""Weights that make the mean of weighted activity 64 x 1024, for one channel before."""

MIXED_HEADER = 8
"""About the bytes of a mixed channel in the header."""

MIXED_SHARE = (0.4, 0.3, 0.3)
SAMPLE_MARGIN = 1.005
"""A mixed channel is tried on all rows unless it is longer than this ratio on the sample."""

SHARES = [
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.6, 0.4),
    (0.5, 0.5, 0.0),
    (0.4, 0.3, 0.3),
    (0.7, 0.15, 0.15),
]
"""Shares of the own column, of the row and of the rows beside it that are tried."""


@dataclass(frozen=True)
class Sample:
    """Rows that stand for all, as one chunk, and their near rows if they have positions."""

    values: Ints
    near: Ints | None = None

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Rows:
    """What a model is fitted to: ``values`` (n, channels) int32 in chunks, ``near`` by position."""

    values: Ints
    chunks: list[slice]
    near: NearRows | None = None

    def near_of(self, model: Models, index: int) -> Ints | None:
        """Near rows of a chunk, or None if ``model`` does not look at them."""
        return self.near.of(index) if self.near and looks_near(model) else None

    def sample(self) -> Sample:
        """All rows, or blocks of neighbouring rows that lie evenly apart."""
        if self.near is None:
            return Sample(take_sample(self.values))
        if len(self.chunks) == 1 and len(self.values) <= SAMPLE_BLOCKS * SAMPLE_ROWS:
            return Sample(self.values, self.near.of(0))
        return Sample(take_sample(self.values), find_near(take_sample(self.near.position)))


def looks_near(model: Models) -> bool:
    """Whether ``model`` looks at near rows."""
    used = np.arange(TAPS) < model["taps"][:, None]
    return bool((used & (model["tap"][:, :, 1] == NEAR)).any())


def fit(rows: Rows, search: bool) -> tuple[Models, int]:
    """The model of ``rows``, and about the bytes of all chunks."""
    count, channels = rows.values.shape
    sample = rows.sample()
    scale = count * 256 // len(sample)
    model = empty_model(channels)
    model["centre"] = find_centres(sample.values)
    if search:
        choose_taps(model, sample, scale)
        choose_activity(model, sample, scale)
    cost = count_all_and_choose(model, rows)
    drop_unused(model)
    return model, int(cost.sum()) // (8 << 16) + sum(map(overhead, rows.chunks))


def overhead(chunk: slice) -> int:
    """About the bytes of a chunk besides its symbols."""
    return 20 if chunk.stop - chunk.start >= LONG_ROWS else 2


def take_sample(values: Ints) -> Ints:
    """All rows, or blocks of neighbouring rows that lie evenly apart."""
    if len(values) <= SAMPLE_BLOCKS * SAMPLE_ROWS:
        return values
    first = [(len(values) - SAMPLE_ROWS) * b // (SAMPLE_BLOCKS - 1) for b in range(SAMPLE_BLOCKS)]
    return np.concatenate([values[f : f + SAMPLE_ROWS] for f in first])


def find_centres(sample: Ints) -> Ints:
    """0 if a quarter of a column is 0, otherwise its mean, halves rounded up."""
    sums = 2 * sample.sum(axis=0, dtype=np.int64) + len(sample)
    centres = sums // (2 * len(sample))
    return np.where(4 * (sample == 0).sum(axis=0) >= len(sample), 0, centres).astype(np.int32)


def count_all_and_choose(model: Models, rows: Rows) -> npt.NDArray[np.uint64]:
    """Set classes and tables of ``model`` from all rows; costs (channels,) in 2^-16 bits."""
    count = np.zeros((len(model), CELLS, TABLE), np.uint32)
    for index, chunk in enumerate(rows.chunks):
        _codec.attributes_count(model, rows.values[chunk], count, rows.near_of(model, index))
    return choose(model, count, 256)


def count_and_choose(model: Models, sample: Sample, scale: int) -> npt.NDArray[np.uint64]:
    """The same from a sample of 256 / ``scale`` of all rows."""
    count = count_sample(model, sample)
    return choose(model, count, scale)


def count_sample(model: Models, sample: Sample) -> npt.NDArray[np.uint32]:
    """Counts (channels, CELLS, TABLE) of symbols by cell."""
    count = np.zeros((len(model), CELLS, TABLE), np.uint32)
    _codec.attributes_count(model, sample.values, count, sample.near)
    return count


def choose(model: Models, count: npt.NDArray[np.uint32], scale: int) -> npt.NDArray[np.uint64]:
    """Set classes and tables of ``model`` by counts; costs (channels,) in 2^-16 bits."""
    cost = np.zeros(len(model), np.uint64)
    _codec.attributes_choose(model, count, min(scale, 2**32 - 1), cost)
    return cost


def choose_taps(model: Models, sample: Sample, scale: int) -> None:
    """Set the terms of predictions that save more bits than they take."""
    trial = model.copy()
    find_taps(trial, sample.values, sample.near)
    if not trial["taps"].any():
        return
    trial["gain"] = model["gain"] = TRIAL_GAIN
    trial["weight"][:, 0] = model["weight"][:, 0] = WEIGHT_OF_OWN
    cost = count_and_choose(model, sample, scale)
    trial_cost = count_and_choose(trial, sample, scale)
    trial_cost += (TAP_COST * trial["taps"]).astype(np.uint64)
    better = trial_cost < cost
    for field in ("taps", "tap"):
        model[field][better] = trial[field][better]
    model["weight"] = 0


def choose_activity(model: Models, sample: Sample, scale: int) -> None:
    """Set gains, weights and spans of ``model`` by what costs least on the sample."""
    plain = model.copy()
    count = count_sample(plain, sample)
    best_cost = choose(plain, count, scale)
    model["gain"] = find_gains(count)
    best = model.copy()
    for share in SHARES:
        trial = model.copy()
        trial["weight"] = weights_of(share, len(model))
        keep_better(best, best_cost, trial, sample, scale)
    for span in (1, 2):
        for weight in (np.zeros_like(best["weight"]), best["weight"].copy()):
            trial = model.copy()
            trial["weight"] = weight
            trial["span"] = np.minimum(span, np.arange(len(model)))
            keep_better(best, best_cost, trial, sample, scale)
    model[:] = best


def find_gains(count: npt.NDArray[np.uint32]) -> Ints:
    """Gains that make the mean magnitude of every channel about 16."""
    sizes = (np.arange(TABLE, dtype=np.int64) + 1) // 2
    symbols = count.sum(axis=1, dtype=np.int64)
    total = np.maximum((symbols * sizes).sum(axis=1), 1)
    gains = np.clip(MAGNITUDE * symbols.sum(axis=1) // total, 1, MAX_GAIN)
    return np.asarray(gains, np.int32)


def weights_of(share: tuple[float, float, float], channels: int) -> Ints:
    """Weights (channels, 3) that give each source its share of the activity."""
    before = np.maximum(np.arange(channels), 1)
    full = np.stack(
        [np.full(channels, WEIGHT_OF_OWN), WEIGHT_OF_ROW // before, WEIGHT_BESIDE // before], 1
    )
    weights = np.minimum(np.rint(full * np.array(share)), MAX_WEIGHT)
    return np.asarray(weights, np.int32)


def keep_better(
    best: Models, best_cost: npt.NDArray[np.uint64], trial: Models, sample: Sample, scale: int
) -> None:
    """Replace the channels of ``best`` that ``trial`` codes in fewer bits."""
    cost = count_and_choose(trial, sample, scale)
    better = cost < best_cost
    best[better] = trial[better]
    best_cost[better] = cost[better]


def drop_unused(model: Models) -> None:
    """Clear what no class depends on, so that it costs no bits of the header."""
    idle = model["classes"] == 1
    model["weight"][idle] = 0
    model["span"][idle] = 0
    looks = np.flatnonzero(model["weight"][:, 1:].any(axis=1))
    needed = np.arange(len(model)) < (looks[-1] if len(looks) else 0)
    model["gain"][~(needed | (model["weight"][:, 0] > 0))] = 0


def choose_mixed(model: Models, rows: Rows) -> Models:
    """``model`` with those channels mixed that take fewer bytes so than by tables.

    Channels that gain nothing on the sample, on which contexts learn less, are not tried on
    all rows.
    """
    sample = rows.sample()
    size = count_all_and_choose(model.copy(), rows) // (8 << 16)
    mixed = all_mixed(model, sample)
    trial_size = np.zeros(len(model), np.uint64)
    _codec.attributes_measure(mixed, sample.values, trial_size, sample.near)
    promising = trial_size * len(rows.values) < size * len(sample) * SAMPLE_MARGIN
    if not promising.any():
        return model
    trial = np.where(promising, mixed, model)
    trial["gain"] = mixed["gain"]
    better = promising & (measure(trial, rows) + MIXED_HEADER < size)
    result = np.where(better, mixed, model)
    last = np.flatnonzero(better)[-1] if better.any() else -1
    result["gain"][: last + 1] = mixed["gain"][: last + 1]
    return result


def all_mixed(model: Models, sample: Sample) -> Models:
    """``model`` with every channel mixed, and with activity if it had none.

    Gains are 0 only after the last channel whose classes depend on them, so no class changes.
    """
    count = count_sample(model, sample)
    mixed = model.copy()
    mixed["coder"], mixed["classes"], mixed["class_of"], mixed["frequency"] = 1, 1, 0, 0
    mixed["gain"] = np.where(model["gain"] == 0, find_gains(count), model["gain"])
    weight = weights_of(MIXED_SHARE, len(model))
    weight[0] = WEIGHT_OF_OWN, 0, 0
    idle = ~model["weight"].any(axis=1)
    mixed["weight"][idle] = weight[idle]
    return mixed


def measure(model: Models, rows: Rows) -> npt.NDArray[np.uint64]:
    """Bytes (channels,) of the channels that are mixed."""
    size = np.zeros(len(model), np.uint64)
    for index, chunk in enumerate(rows.chunks):
        _codec.attributes_measure(model, rows.values[chunk], size, rows.near_of(model, index))
    return size
