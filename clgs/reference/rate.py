"""The rate proxy in float64, symbol by symbol, from its two forms."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def symbols(x: npt.NDArray[np.floating], q: float) -> Array:
    """rint(x q) as the kernels see it: the product rounded to the precision of ``x``."""
    return np.asarray(np.rint(x * x.dtype.type(q)), np.float64)


def laplace_nats(distance: Array, b: Array) -> Array:
    """-log of the Laplace mass of a unit interval at ``distance`` from mu, in the log domain."""
    edge = -np.log(-np.expm1(-1 / b) / 2)
    inner = np.minimum(distance, 0.5)
    near = -np.log(-(np.expm1(-(0.5 - inner) / b) + np.expm1(-(0.5 + inner) / b)) / 2)
    return np.where(distance >= 0.5, (distance - 0.5) / b + edge, near)


def laplace_gradient(distance: Array, b: Array) -> tuple[Array, Array]:
    """Derivatives of :func:`laplace_nats` by distance and by b."""
    inner = np.minimum(distance, 0.5)
    lower, upper = np.exp(-(0.5 - inner) / b), np.exp(-(0.5 + inner) / b)
    mass = -(np.expm1(-(0.5 - inner) / b) + np.expm1(-(0.5 + inner) / b)) / 2
    near_b = (lower * (0.5 - inner) + upper * (0.5 + inner)) / (2 * b**2 * mass)
    far_b = (np.exp(-1 / b) / -np.expm1(-1 / b) - (distance - 0.5)) / b**2
    by_distance = np.where(distance >= 0.5, 1 / b, (lower - upper) / (2 * b * mass))
    return by_distance, np.where(distance >= 0.5, far_b, near_b)


def forward(n: Array, form: str = "channel") -> float:
    """Bits a row of symbols ``n`` (rows, channels)."""
    if n.size == 0:
        return 0.0
    nats = _pooled(n)[0] if form == "pooled" else _per_channel(n)[0]
    return float(nats.sum() / np.log(2) / len(n))


def backward(n: Array, form: str = "channel") -> Array:
    """Gradient of :func:`forward` by ``n`` (rows, channels), through mean and scale as well."""
    if n.size == 0:
        return np.zeros_like(n)
    d_n = _pooled(n)[1] if form == "pooled" else _per_channel(n)[1]
    return np.asarray(d_n / np.log(2) / len(n))


def _per_channel(n: Array) -> tuple[Array, Array]:
    """(nats, gradient of their sum), both (rows, channels)."""
    mu = n.mean(axis=0)
    b = np.sqrt(np.mean((n - mu) ** 2, axis=0) / 2)
    active = b > 0
    b = np.where(active, b, 1.0)
    by_distance, by_b = laplace_gradient(np.abs(n - mu), b)
    by_n = by_distance * np.sign(n - mu)
    d_b = by_b.sum(axis=0)
    d_n = by_n - by_n.mean(axis=0) + d_b * (n - mu) / (2 * b * len(n))
    return np.where(active, laplace_nats(np.abs(n - mu), b), 0), np.where(active, d_n, 0)


def _pooled(n: Array) -> tuple[Array, Array]:
    """The published code: one mean and deviation, deviation as b, clamped and floored."""
    mu = n.mean()
    degrees = max(n.size - 1, 1)
    deviation = np.sqrt(np.sum((n - mu) ** 2) / degrees)
    scale = np.maximum(deviation, 0.01)
    clamped = np.abs(n - mu) > 3 * scale
    distance = np.where(clamped, 3 * scale, np.abs(n - mu))
    nats = laplace_nats(distance, scale)
    by_distance, by_scale = laplace_gradient(distance, scale)
    free = nats <= np.log(1e5)
    d_scale = np.sum(np.where(free, by_scale + np.where(clamped, 3 * by_distance, 0), 0))
    by_n = np.where(free & ~clamped, by_distance * np.sign(n - mu), 0)
    d_n = by_n - by_n.mean()
    if deviation >= 0.01:
        d_n = d_n + d_scale * (n - mu) / (deviation * degrees)
    return np.minimum(nats, np.log(1e5)), d_n
