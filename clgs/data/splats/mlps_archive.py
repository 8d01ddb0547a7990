"""The MLPs next to a PLY file of anchors: a NumPy archive with the reference's names of weights.

The reference keeps them in torch files, which are pickles and never read here.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import HEAD_DIMS
from clgs.errors import DataError
from clgs.scene.mlps import LAYERS, MLP_SIZE, Mlps, unpack_head
from clgs.scene.storage import DAMAGE, describe_damage, load_archive

TORCH_HEADS = {"opacity": "opacity_mlp", "color": "color_mlp", "covariance": "cov_mlp"}
TORCH_LAYERS = dict(zip(LAYERS, ("0.weight", "0.bias", "2.weight", "2.bias"), strict=True))
"""The reference's names of the weights: ``opacity_mlp.0.weight`` and so on."""

FIRST = f"{TORCH_HEADS['opacity']}.0.weight"


def mlps_path(path: Path) -> Path:
    """Where the MLPs of ``path`` lie: scene.ply and scene.quantized.ply have scene.mlps.npz."""
    stem = path.name
    for ending in (".ply", ".quantized"):
        if stem.lower().endswith(ending):
            stem = stem[: -len(ending)]
    return path.with_name(f"{stem}.mlps.npz")


def pack_mlps(mlps: Mlps) -> bytes:
    """The archive of ``mlps``, a pure function of them."""
    arrays: dict[str, Any] = {
        f"{TORCH_HEADS[head]}.{TORCH_LAYERS[layer]}": array
        for head in HEAD_DIMS
        for layer, array in mlps.head(head).items()
    }
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def load_mlps(path: Path) -> Mlps:
    """The weights in an archive: ``mlps`` (13710,), or the reference's names.

    Raises:
        DataError: missing, damaged, or another network.
    """
    try:
        with path.open("rb") as file, load_archive(file) as archive:
            flat = _flat_weights(archive)
    except FileNotFoundError:
        raise DataError(
            f"{path}: the PLY file has no MLPs and this file is missing; name one with --mlps: "
            f"arrays {FIRST} ... saved from the torch file by np.savez"
        ) from None
    except DAMAGE as error:
        raise DataError(
            f"{path}: not an archive of the MLPs ({describe_damage(error)}); save arrays {FIRST} "
            "... by np.savez"
        ) from None
    if not np.isfinite(flat).all():
        raise DataError(f"{path}: a weight is not finite; train the scene again")
    return Mlps(flat)


def holds(path: Path, mlps: Mlps) -> bool:
    """Whether ``path`` is an archive of the very weights of ``mlps``."""
    try:
        found = load_mlps(path)
    except DataError:
        return False
    return bool((found.flat.view(np.uint32) == mlps.flat.view(np.uint32)).all())


def _flat_weights(archive: Any) -> npt.NDArray[np.float32]:
    flat = np.empty(MLP_SIZE, np.float32)
    if "mlps" in archive.files:
        flat[...] = archive["mlps"]
        return flat
    for head in HEAD_DIMS:
        for layer, target in unpack_head(flat, head).items():
            name = f"{TORCH_HEADS[head]}.{TORCH_LAYERS[layer]}"
            array = archive[name]
            if array.shape != target.shape:
                raise ValueError(f"{name} has shape {array.shape}, {target.shape} is needed")
            target[...] = array
    return flat
