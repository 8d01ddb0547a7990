"""The encoder's search for the model of attribute channels (codec_c/FORMAT.md on attributes).

Choices are made by exact cost on a sample of rows; tables are made from all rows. All decisions
rest on integers, or on floating-point operations that IEEE 754 defines to the bit, so that every
machine writes the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs import _codec
from clgs.codec.attribute_model import (
    CELLS,
    FACTOR,
    KNOWN,
    MAX_FACTOR,
    MAX_GAIN,
    MAX_WEIGHT,
    MIXED,
    SIDED,
    TABLE,
    TAPS,
    Ints,
    Models,
    NearRows,
    empty_model,
    find_near,
    find_sides,
    find_taps,
    looks_near,
)

SAMPLE_BLOCKS, SAMPLE_ROWS = 8, 2048
LONG_ROWS = 2048
"""Chunks of at least this many rows have eight lanes, shorter ones have one."""

TAP_COST = 24 << 16
"""Bits of a term in the header, in 2^-16 bits."""

TRIAL_GAIN = 64
"""The gain while predictions are tried; levels are then those of the own column only."""

MAGNITUDE = 256
"""16 times the mean magnitude that gains give a channel."""

WEIGHT_OF_OWN, WEIGHT_OF_ROW, WEIGHT_BESIDE = 1365, 4096, 2048
"""Weights that make the mean of weighted activity 64 x 1024, if one channel comes before."""

MIXED_HEADER = 8
"""About how many bytes a mixed channel takes in the header."""

MIXED_SHARE = (0.4, 0.3, 0.3)
SAMPLE_MARGIN = 1.005
"""A mixed channel that is longer by this ratio on the sample is not tried on all rows."""

SHARES = [
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.6, 0.4),
    (0.5, 0.5, 0.0),
    (0.4, 0.3, 0.3),
    (0.7, 0.15, 0.15),
]
"""The shares that are tried, of the own column, of the row, and of the rows above and below it."""


Costs = npt.NDArray[np.uint64]
"""(channels,) in 2^-16 bits."""


@dataclass(frozen=True)
class RowSample:
    """Rows that stand for all, as one chunk.

    ``near``: their near rows if they have positions; ``scale``: how many rows there are in all, in
    1/256 of the rows of the sample.
    """

    values: Ints
    near: Ints | None = None
    scale: int = 256

    def count(self, model: Models) -> npt.NDArray[np.uint32]:
        """Counts (channels, CELLS, TABLE) of symbols by cell."""
        count = np.zeros((len(model), CELLS, TABLE), np.uint32)
        _codec.attributes_count(model, self.values, count, self.near)
        return count

    def choose(self, model: Models, count: npt.NDArray[np.uint32] | None = None) -> Costs:
        """Set classes and tables of ``model`` by its ``count``; what all rows would cost."""
        count = self.count(model) if count is None else count
        cost = np.zeros(len(model), np.uint64)
        _codec.attributes_choose(model, count, min(self.scale, 2**32 - 1), cost)
        return cost


@dataclass(frozen=True)
class RowChunks:
    """What a model is fitted to: ``values`` (n, channels) int32 in chunks, ``near`` by position.

    ``step``: if not 0, channels of even number are quotients by it, which a reader has already.
    """

    values: Ints
    chunks: list[slice]
    near: NearRows | None = None
    step: int = 0

    def with_near(self, model: Models | None) -> Iterator[tuple[Ints, Ints | None]]:
        """Each chunk, and its near rows if ``model`` looks at them."""
        near = self.near if model is not None and looks_near(model) else None
        for index, chunk in enumerate(self.chunks):
            yield self.values[chunk], near.of(index) if near else None

    def sample(self) -> RowSample:
        """All rows, or blocks of neighbouring rows that lie evenly apart."""
        values = take_sample(self.values)
        near = None
        if self.near is not None and len(self.chunks) == 1 and len(values) == len(self.values):
            near = self.near.of(0)
        elif self.near is not None:
            near = find_near(take_sample(self.near.position))
        return RowSample(values, near, len(self.values) * 256 // len(values))

    def choose(self, model: Models) -> Costs:
        """Set classes and tables of ``model`` from all rows; their cost."""
        count = np.zeros((len(model), CELLS, TABLE), np.uint32)
        for values, near in self.with_near(model):
            _codec.attributes_count(model, values, count, near)
        cost = np.zeros(len(model), np.uint64)
        _codec.attributes_choose(model, count, 256, cost)
        return cost

    def measure_mixed(self, model: Models) -> Costs:
        """Bytes (channels,) of the channels that are mixed."""
        size = np.zeros(len(model), np.uint64)
        for values, near in self.with_near(model):
            _codec.attributes_measure(model, values, size, near)
        return size


def take_sample(values: Ints) -> Ints:
    """All rows, or blocks of neighbouring rows that lie evenly apart."""
    if len(values) <= SAMPLE_BLOCKS * SAMPLE_ROWS:
        return values
    first = [(len(values) - SAMPLE_ROWS) * b // (SAMPLE_BLOCKS - 1) for b in range(SAMPLE_BLOCKS)]
    return np.concatenate([values[f : f + SAMPLE_ROWS] for f in first])


def fit(rows: RowChunks, search: bool) -> tuple[Models, int]:
    """The model of ``rows``, and about how many bytes all chunks take.

    ``search``: look for predictions and classes; without it every channel that is not sided has
    one table.
    """
    sample = rows.sample()
    count = len(sample.values)
    model = empty_model(rows.values.shape[1])
    # the mean, halves rounded up; 0 if a quarter of a column is 0
    means = (2 * sample.values.sum(axis=0, dtype=np.int64) + count) // (2 * count)
    model["centre"] = np.where(4 * (sample.values == 0).sum(axis=0) >= count, 0, means)
    if rows.step:
        model["coder"][::2], model["frequency"][::2] = KNOWN, 0
    if search:
        choose_taps(model, sample)
        choose_activity(model, sample)
    if 0 < rows.step <= MAX_FACTOR // FACTOR and sample.near is not None:
        choose_sided(model, sample, sample.near, rows.step)
    cost = rows.choose(model)
    # clear what no class depends on, so that it costs no bits of the header
    idle = model["classes"] == 1
    model["weight"][idle] = 0
    model["span"][idle] = 0
    looks = np.flatnonzero(model["weight"][:, 1:].any(axis=1))
    needed = np.arange(len(model)) < (looks[-1] if len(looks) else 0)
    model["gain"][~(needed | (model["weight"][:, 0] > 0))] = 0
    overhead = sum(20 if c.stop - c.start >= LONG_ROWS else 2 for c in rows.chunks)
    return model, int(cost.sum()) // (8 << 16) + overhead


def choose_taps(model: Models, sample: RowSample) -> None:
    """Set the terms of predictions that save more bits than they take."""
    trial = model.copy()
    find_taps(trial, sample.values, sample.near)
    trial["taps"][trial["coder"] == KNOWN] = 0
    if not trial["taps"].any():
        return
    trial["gain"] = model["gain"] = TRIAL_GAIN
    trial["weight"][:, 0] = model["weight"][:, 0] = WEIGHT_OF_OWN
    cost = sample.choose(model)
    trial_cost = sample.choose(trial) + (TAP_COST * trial["taps"]).astype(np.uint64)
    better = trial_cost < cost
    for field in ("taps", "tap"):
        model[field][better] = trial[field][better]
    model["weight"] = 0


def choose_activity(model: Models, sample: RowSample) -> None:
    """Set gains, weights and spans of ``model`` by what costs least on the sample."""
    plain = model.copy()
    count = sample.count(plain)
    best_cost = sample.choose(plain, count)
    model["gain"] = find_gains(count)
    best = model.copy()

    def keep_better(trial: Models) -> None:
        """Replace the channels of ``best`` that ``trial`` codes in fewer bits."""
        cost = sample.choose(trial)
        better = cost < best_cost
        best[better] = trial[better]
        best_cost[better] = cost[better]

    for share in SHARES:
        trial = model.copy()
        trial["weight"] = weights_of(share, len(model))
        keep_better(trial)
    for span in (1, 2):
        for weight in (np.zeros_like(best["weight"]), best["weight"].copy()):
            trial = model.copy()
            trial["weight"] = weight
            trial["span"] = np.minimum(span, np.arange(len(model)))
            keep_better(trial)
    model[:] = best


def choose_sided(model: Models, sample: RowSample, near: Ints, step: int) -> None:
    """Have those channels of odd number sided that take fewer bits so."""
    odd = np.arange(len(model)) % 2 == 1
    best = model.copy()
    best_cost = sample.choose(best) + TAP_COST * best["taps"].astype(np.uint64)
    for most in (0, TAPS - 1):  # 0: by the quotient alone
        trial = model.copy()
        find_sides(trial, sample.values, near, step, most)
        trial["coder"][odd], trial["weight"][odd], trial["span"][odd] = SIDED, 0, 1
        cost = sample.choose(trial) + TAP_COST * trial["taps"].astype(np.uint64)
        better = odd & (cost < best_cost)
        best[better], best_cost[better] = trial[better], cost[better]
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


def choose_mixed(model: Models, rows: RowChunks) -> Models:
    """``model`` with those channels mixed that take fewer bytes so than by tables.

    Channels that gain nothing on the sample, on which contexts learn less, are not tried on
    all rows.
    """
    sample = rows.sample()
    size = rows.choose(model.copy()) // (8 << 16)
    mixed = mix_all(model, sample)
    trial_size = np.zeros(len(model), np.uint64)
    _codec.attributes_measure(mixed, sample.values, trial_size, sample.near)
    promising = trial_size * len(rows.values) < size * len(sample.values) * SAMPLE_MARGIN
    if not promising.any():
        return model
    trial = np.where(promising, mixed, model)
    trial["gain"] = mixed["gain"]
    better = promising & (rows.measure_mixed(trial) + MIXED_HEADER < size)
    result = np.where(better, mixed, model)
    last = np.flatnonzero(better)[-1] if better.any() else -1
    result["gain"][: last + 1] = mixed["gain"][: last + 1]
    return result


def mix_all(model: Models, sample: RowSample) -> Models:
    """``model`` with every channel mixed, and with activity if it had none.

    Gains are 0 only after the last channel whose classes depend on them, so no class changes.
    """
    mixed = model.copy()
    mixed["coder"] = np.where(model["coder"] == KNOWN, KNOWN, MIXED)
    mixed["classes"], mixed["class_of"], mixed["frequency"] = 1, 0, 0
    gains = find_gains(sample.count(model))
    mixed["gain"] = np.where(model["gain"] == 0, gains, model["gain"])
    weight = weights_of(MIXED_SHARE, len(model))
    weight[0] = WEIGHT_OF_OWN, 0, 0
    idle = ~model["weight"].any(axis=1)
    mixed["weight"][idle] = weight[idle]
    return mixed
