"""Neural Gaussians from the MLPs' outputs in float64, forward and backward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, LOG_SCALE_LIMIT
from clgs.reference.project import Array, across

Indices = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Gaussians:
    """The fields of ``clgs.ops.neural.Gaussians``, float64."""

    mean: Array
    scale: Array
    rotation: Array
    color: Array
    opacity: Array


@dataclass(frozen=True)
class NeuralGaussians(Gaussians):
    """Gaussians, and ``slot`` of ``clgs.ops.neural.NeuralGaussians``."""

    slot: Indices


@dataclass(frozen=True)
class GaussianGradients:
    """The fields of ``clgs.ops.neural.GaussianGradients``."""

    d_mean: Array
    d_scale: Array
    d_rotation: Array
    d_color: Array
    d_opacity: Array


def split(output: Array) -> tuple[Array, Array, Array, Array]:
    """Opacity (S,), color (S, 3), scale logits (S, 3), quaternion (S, 4) of all S = V K slots."""
    columns = output.T
    color = columns[:, K_OFFSETS : 4 * K_OFFSETS].reshape(-1, 3)
    covariance = columns[:, 4 * K_OFFSETS :].reshape(-1, 7)
    return columns[:, :K_OFFSETS].reshape(-1), color, covariance[:, :3], covariance[:, 3:]


def join(opacity: Array, color: Array, covariance: Array) -> Array:
    """The inverse of :func:`split`: (110, V)."""
    count = len(opacity) // K_OFFSETS
    parts = [
        opacity.reshape(count, K_OFFSETS),
        color.reshape(count, 3 * K_OFFSETS),
        covariance.reshape(count, 7 * K_OFFSETS),
    ]
    return np.concatenate(parts, axis=1).T


def unit_quaternion(q: Array) -> tuple[Array, Array]:
    """q / |q| (N, 4) and |q| (N, 1); zeros if the largest component is tiny or not finite."""
    largest = np.abs(q).max(axis=1, keepdims=True, initial=0)
    with np.errstate(invalid="ignore"):
        valid = (largest > 1e-35) & (largest < 1e37)
    length = np.linalg.norm(np.where(valid, q, 0), axis=1, keepdims=True)
    return np.where(valid, q, 0) / np.where(valid, length, 1), length


def bounded_exp(x: Array) -> Array:
    """exp with its argument clamped."""
    return np.exp(np.clip(x, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT))


def sigmoid(x: Array) -> Array:
    """1 / (1 + exp(-x))."""
    return 1 / (1 + np.exp(-x))


def forward(
    output: Array, visible: Indices, position: Array, offset: Array, scaling: Array
) -> NeuralGaussians:
    """Gather the Gaussians; shapes as in ``clgs.ops.neural.forward``, output without padding."""
    opacity, color, logits, quaternion = split(output)
    drawn = np.flatnonzero(opacity > 0)
    anchor = visible[drawn // K_OFFSETS]
    scales = bounded_exp(scaling[anchor])
    return NeuralGaussians(
        mean=position[anchor] + offset[anchor, drawn % K_OFFSETS] * scales[:, :3],
        scale=scales[:, 3:] * sigmoid(logits[drawn]),
        rotation=unit_quaternion(quaternion[drawn])[0],
        color=color[drawn],
        opacity=opacity[drawn],
        slot=drawn.astype(np.int32),
    )


def backward(
    gaussians: NeuralGaussians,
    output: Array,
    visible: Indices,
    offset: Array,
    scaling: Array,
    d_gaussians: GaussianGradients,
) -> tuple[Array, Array, Array]:
    """d_output (110, V), d_offset (A, K, 3) and d_scaling (A, 6)."""
    slot = gaussians.slot
    anchor, j = visible[slot // K_OFFSETS], slot % K_OFFSETS
    _, _, logits, quaternion = split(output)
    reach = bounded_exp(scaling[anchor])[:, :3]
    d_log_scale = d_gaussians.d_scale * gaussians.scale
    d_covariance = np.zeros((output.shape[1] * K_OFFSETS, 7))
    d_covariance[slot, :3] = d_log_scale * (1 - sigmoid(logits[slot]))
    unit, length = unit_quaternion(quaternion[slot])
    d_unit = across(unit, d_gaussians.d_rotation)
    d_covariance[slot, 3:] = np.where(length > 0, d_unit / np.where(length > 0, length, 1), 0)
    d_opacity, d_color = np.zeros(len(d_covariance)), np.zeros((len(d_covariance), 3))
    d_opacity[slot], d_color[slot] = d_gaussians.d_opacity, d_gaussians.d_color
    d_offset, d_scaling = np.zeros_like(offset), np.zeros_like(scaling)
    d_offset[anchor, j] = d_gaussians.d_mean * reach
    np.add.at(d_scaling[:, :3], anchor, d_gaussians.d_mean * reach * offset[anchor, j])
    np.add.at(d_scaling[:, 3:], anchor, d_log_scale)
    d_scaling[~(np.abs(scaling) <= LOG_SCALE_LIMIT)] = 0
    return join(d_opacity, d_color, d_covariance), d_offset, d_scaling
