"""Rounding of features whose errors make up for each other in the pictures.

Features reach pictures through the networks, where the errors of all channels of an anchor add up.
One channel is rounded after the other, and those that are left take what makes up for the errors so
far (Frantar et al., GPTQ, 2022, do so with weights of networks).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS
from clgs.scene.mlps import Mlps

Floats = npt.NDArray[np.float64]

DAMPING = 0.01
"""This share of their mean is added to the squares, so that no direction is free."""


def hidden_products(mlps: Mlps) -> Floats:
    """How errors of features (F, F) add up in the hidden layers: a stand-in without views."""
    weights = [mlps.head(head)["hidden_weight"][:, :FEATURE_DIM] for head in HEAD_DIMS]
    stacked = np.concatenate(weights).astype(np.float64)
    return np.asarray(stacked.T @ stacked)


def compensated(values: Floats, products: Floats) -> Floats:
    """Round ``values`` (A, F) so that the sum of e @ products @ e over the errors e stays small.

    Channels that matter most come first. ``products`` (F, F): symmetric, no eigenvalue below 0.
    """
    squares = np.diag(products)
    order = np.argsort(-squares, kind="stable")
    damping = DAMPING * float(squares.mean()) or 1.0
    damped = products[np.ix_(order, order)] + damping * np.eye(len(order))
    shares = np.linalg.cholesky(np.linalg.inv(damped)).T
    left, rounded = np.ascontiguousarray(values[:, order].T), np.empty(values.shape)
    for channel, share in enumerate(shares):
        whole = np.rint(left[channel])
        error = (left[channel] - whole) / share[channel]
        left[channel + 1 :] -= share[channel + 1 :, None] * error
        rounded[:, order[channel]] = whole
    return rounded
