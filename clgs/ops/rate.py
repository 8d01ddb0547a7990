"""The rate proxy: bits that an ideal coder needs for an attribute (Voxel-GS).

A symbol n = rint(x q) costs -log2 of the Laplace mass of [n - 1/2, n + 1/2]. With d = |n - mu|, in
nats,

    d >= 1/2:  (d - 1/2)/b - log((1 - exp(-1/b))/2)
    d <  1/2:  -log(1 - (exp(-(1/2 - d)/b) + exp(-(1/2 + d)/b))/2)

Form "channel" (the default): mu and b = std/sqrt(2) of every channel, no clamp and no floor; a
channel of equal symbols costs nothing. Form "pooled" is the code of Voxel-GS: one mean and standard
deviation (unbiased, at least 0.01) for the whole attribute, the deviation taken as b, d clamped to
3 deviations, the mass floored at 1e-5. Gradients flow through mu and b, and stop at clamps.

At most one integer lies within 1/2 of mu, and beyond it the cost is linear in d. So a channel's
bits follow from five sums of integers, which the kernels take; the rest is float64 on the host.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items, by_parts, filled
from clgs.opencl.kernel import Kernel

Form = Literal["channel", "pooled"]
Values = npt.NDArray[np.float64]

VECTORS_PER_BLOCK = 256
"""Vectors of a column that a work-item sums."""

MOST_ATTRIBUTES = 3
"""Attributes of a launch of :func:`backward`."""

POOLED_CLAMP = 3.0
POOLED_MIN_SCALE = 0.01
POOLED_MAX_NATS = float(np.log(1e5))


@dataclass(frozen=True)
class Rate:
    """Bits per row, and their derivative by the symbols.

    ``table`` (8, channels; 1 channel if pooled) float64: the centre m; with k = n - m the limits
    low and high of k; the slope by k; and the offsets for k below, at and above 0 and outside of
    the limits. The derivative by a symbol is slope * k + offset.
    """

    bits: float
    q: float
    table: Values


@dataclass(frozen=True)
class Cost:
    """Nats of symbols at a distance from mu, and their derivatives by distance and by b."""

    nats: Values
    by_distance: Values
    by_b: Values


@dataclass(frozen=True)
class _ChannelSums:
    """Per channel: number of symbols, centre, mean - centre, and the sums of rate_statistics."""

    count: int
    centre: Values
    mean: Values
    below: Values
    above: Values
    outside: Values
    distance: Values
    square: Values


def forward(device: Device, x: DeviceArray, q: float, form: Form = "channel") -> Rate:
    """Bits per row of the symbols rint(x q).

    ``x`` (rows, ...) float32: every index after the first is a channel.

    Raises:
        TypeError: ``x`` is not float32.
        ValueError: there is no such form.
    """
    if form not in ("channel", "pooled"):
        raise ValueError(f"form is '{form}'; use channel or pooled")
    if x.dtype != np.float32:
        raise TypeError(f"x: dtype is {x.dtype}, expected float32")
    channels = int(np.prod(x.shape[1:])) if form == "channel" else 1
    if x.size == 0:
        return Rate(0.0, q, np.zeros((8, channels)))
    with np.errstate(all="ignore"):
        mean = _sums(device, "rate_total", 1, (x, q, channels))[0] / (x.size // channels)
        centre = np.rint(mean)
        sums = _statistics(device, x, q, (centre, mean - centre), None)
        if form == "pooled":
            # the largest distance from the mean at which the cost still varies: clamp or floor
            b = np.maximum(_deviation(sums), POOLED_MIN_SCALE)
            floor = 0.5 + b * (POOLED_MAX_NATS + np.log(-0.5 * np.expm1(-1 / b)))
            limits = np.minimum(POOLED_CLAMP * b, floor)
            sums = _statistics(device, x, q, (sums.centre, sums.mean), limits)
            nats, table = _pooled(sums, limits)
        else:
            # b = std/sqrt(2), and no limits
            b = np.sqrt(0.5 * (sums.square / sums.count - sums.mean**2))
            constant = b == 0
            b = np.where(constant, 1.0, b)
            at_centre = cost(np.abs(sums.mean), b)
            far = _far_sums(sums, b)
            hits = sums.count - sums.below - sums.above
            nats = hits * at_centre.nats + far.nats
            by_b = hits * at_centre.by_b + far.by_b
            infinite = np.full_like(b, np.inf)
            table = _table(sums, b, at_centre, by_b / (2 * b * sums.count), infinite)
            table[3:, constant] = 0
            nats = np.where(constant, 0.0, nats)
    scale = 1.0 / (np.log(2.0) * x.shape[0])
    table[3:] *= scale
    return Rate(float(nats.sum() * scale), q, table)


@dataclass(frozen=True)
class Slopes:
    """A :class:`Rate` times its weight in the loss, on the device; the table's last rows differ."""

    q: float
    channels: int
    table: DeviceArray


def slopes(device: Device, rate: Rate, weight: float) -> Slopes:
    """What :func:`backward` needs for ``weight * rate.bits`` in the loss."""
    table = rate.table.copy()
    table[3:] *= weight * rate.q
    return Slopes(rate.q, table.shape[1], _upload(device, table))


def backward(device: Device, attributes: Sequence[tuple[Slopes, DeviceArray, DeviceArray]]) -> None:
    """Add gradients for each (slopes, x, d_x), three at most, in one launch.

    x: what :func:`forward` had, float32; d_x: float32, as many elements, changed in place. The
    gradient of rounding is passed through.

    Raises:
        ValueError, TypeError: a ``d_x`` does not fit.
    """
    for _, x, d_x in attributes:
        if d_x.size != x.size or d_x.dtype != np.float32:
            raise ValueError(f"d_x: {d_x.dtype}{d_x.shape} does not fit x {x.shape}")
    sizes, scales, periods = np.zeros(4, np.uint32), np.ones(4, np.float32), np.ones(4, np.uint32)
    for i, (own, x, _) in enumerate(attributes):
        sizes[i], scales[i], periods[i] = x.size, own.q, own.channels
    arrays: dict[str, DeviceArray] = {}
    for i, (own, x, d_x) in enumerate(filled(attributes, MOST_ATTRIBUTES)):
        arrays |= {f"x{i}": x, f"tables{i}": own.table, f"d_x{i}": d_x}
    device.run(
        _kernel(device, "rate_backward"),
        *by_parts(sizes.tolist(), device.vec),
        **arrays,
        sizes=sizes,
        scales=scales,
        periods=periods,
    )


def cost(distance: Values, b: Values) -> Cost:
    """Nats of symbols at ``distance`` >= 0 from mu under Laplace scale ``b`` > 0, both (n,)."""
    with np.errstate(all="ignore"):
        near, far = _near(np.minimum(distance, 0.5), b), _far(distance, b)
    outer = distance >= 0.5
    return Cost(
        np.where(outer, far.nats, near.nats),
        np.where(outer, far.by_distance, near.by_distance),
        np.where(outer, far.by_b, near.by_b),
    )


def _far(distance: Values, b: Values) -> Cost:
    beyond = distance - 0.5
    nats = beyond / b - np.log(-0.5 * np.expm1(-1 / b))
    return Cost(nats, 1 / b, (1 / np.expm1(1 / b) - beyond) / b**2)


def _near(distance: Values, b: Values) -> Cost:
    inner, outer = -(0.5 - distance) / b, -(0.5 + distance) / b
    lower, upper = np.exp(inner), np.exp(outer)
    mass = -0.5 * (np.expm1(inner) + np.expm1(outer))
    # each form keeps the digits that the other loses: at a mass near 1, and at a small mass
    nats = np.where(b < 0.7, -np.log1p(-0.5 * (lower + upper)), -np.log(mass))
    by_distance = (lower - upper) / (2 * b * mass)
    by_b = (lower * (0.5 - distance) + upper * (0.5 + distance)) / (2 * b**2 * mass)
    return Cost(nats, by_distance, by_b)


def _deviation(sums: _ChannelSums) -> Values:
    return np.sqrt((sums.square - sums.count * sums.mean**2) / max(sums.count - 1, 1))


def _pooled(sums: _ChannelSums, limits: Values) -> tuple[Values, Values]:
    """Nats and ``Rate.table`` by nats, in the form of the code of Voxel-GS."""
    deviation = _deviation(sums)
    b = np.maximum(deviation, POOLED_MIN_SCALE)
    at_centre = _floored(cost(np.abs(sums.mean), b))
    clamped = _floored(cost(POOLED_CLAMP * b, b))
    far = _far_sums(sums, b)
    hits = sums.count - sums.below - sums.above - sums.outside
    nats = hits * at_centre.nats + far.nats + sums.outside * clamped.nats
    by_b = hits * at_centre.by_b + far.by_b
    by_b += sums.outside * (POOLED_CLAMP * clamped.by_distance + clamped.by_b)
    free = deviation >= POOLED_MIN_SCALE
    slope = np.where(free, by_b / (max(sums.count - 1, 1) * b), 0.0)
    return nats, _table(sums, b, at_centre, slope, limits)


def _floored(cost_of: Cost) -> Cost:
    free = cost_of.nats <= POOLED_MAX_NATS
    return Cost(
        np.minimum(cost_of.nats, POOLED_MAX_NATS),
        np.where(free, cost_of.by_distance, 0.0),
        np.where(free, cost_of.by_b, 0.0),
    )


def _far_sums(sums: _ChannelSums, b: Values) -> Cost:
    """Sums over the symbols that are neither at the centre nor outside of the limits."""
    count = sums.below + sums.above
    distance = sums.distance - sums.mean * (sums.above - sums.below)
    edge = _far(np.full_like(b, 0.5), b)
    beyond = distance - 0.5 * count
    return Cost(
        beyond / b + count * edge.nats,
        count / b,
        count * edge.by_b - beyond / b**2,
    )


def _table(sums: _ChannelSums, b: Values, at_centre: Cost, slope: Values, limits: Values) -> Values:
    """``Rate.table`` by nats; mu moves by 1/count with every symbol."""
    centre_slope = np.sign(-sums.mean) * at_centre.by_distance
    hits = sums.count - sums.below - sums.above - sums.outside
    total = (sums.above - sums.below) / b + hits * centre_slope
    shared = -total / sums.count - slope * sums.mean
    low, high = np.ceil(sums.mean - limits), np.floor(sums.mean + limits)
    sides = (shared - 1 / b, shared + centre_slope, shared + 1 / b, shared)
    return np.stack([sums.centre, np.minimum(low, 0), np.maximum(high, 0), slope, *sides])


def _statistics(
    device: Device, x: DeviceArray, q: float, mean: tuple[Values, Values], limits: Values | None
) -> _ChannelSums:
    centre, fraction = mean
    reach = np.full_like(centre, np.inf) if limits is None else limits
    low = np.minimum(np.ceil(fraction - reach), 0)
    high = np.maximum(np.floor(fraction + reach), 0)
    tables = {"centre": centre[None], "limits": np.stack([low, high])}
    columns = _sums(device, "rate_statistics", 5, (x, q, len(centre)), **tables)
    return _ChannelSums(x.size // len(centre), centre, fraction, *columns)


def _sums(
    device: Device,
    kernel: str,
    planes: int,
    source: tuple[DeviceArray, float, int],
    **tables: Values,
) -> Values:
    """Sums (planes, channels) of a kernel over (x, q, channels), added up in float64."""
    x, q, channels = source
    blocks = -(-x.size // (device.vec * channels * VECTORS_PER_BLOCK))
    sums = device.empty((planes, blocks, device.vec, channels))
    device.run(
        _kernel(device, kernel),
        *by_items(blocks * channels),
        x=x,
        total=np.uint32(x.size),
        q=np.float32(q),
        period=np.uint32(channels),
        blocks=np.uint32(blocks),
        sums=sums,
        **{name: _upload(device, table) for name, table in tables.items()},
    )
    return np.asarray(device.download(sums).sum(axis=(1, 2), dtype=np.float64))


def _kernel(device: Device, name: str) -> Kernel:
    return device.kernel("anchors/rate", name, VECTORS_PER_BLOCK=VECTORS_PER_BLOCK)


def _upload(device: Device, table: Values) -> DeviceArray:
    """A table (rows, channels), repeated for every lane row of the kernels' period."""
    return device.upload(np.tile(table, (1, device.vec)).astype(np.float32))
