"""The weights of LPIPS with VGG-16, read from a NumPy archive and checked."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.errors import DataError
from clgs.scene.storage import DAMAGE, describe_damage

BLOCKS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Output channels of the convolutions of VGG-16 (Simonyan and Zisserman 2015), block by block."""

DTYPES = (np.dtype(np.float16), np.dtype(np.float32))

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class LpipsWeights:
    """All float32.

    kernels, biases: of each convolution (3, 3, inputs, outputs) and (outputs,), in the order of the
    network; linear: of each block (channels,), what the square of a difference counts.
    """

    kernels: tuple[Array, ...]
    biases: tuple[Array, ...]
    linear: tuple[Array, ...]


def expected_arrays() -> Iterator[tuple[str, tuple[int, ...]]]:
    """Name and shape of every array of the archive, in the order of the network."""
    inputs, number = 3, 0
    for outputs in (channels for block in BLOCKS for channels in block):
        yield f"VGG16_0/Conv_{number}/kernel", (3, 3, inputs, outputs)
        yield f"VGG16_0/Conv_{number}/bias", (outputs,)
        inputs, number = outputs, number + 1
    for number, block in enumerate(BLOCKS):
        yield f"NetLinLayer_{number}/Conv_0/kernel", (1, 1, block[-1], 1)


def read_lpips_weights(path: Path) -> LpipsWeights:
    """Read an .npz of float16 or float32 arrays, all of :func:`expected_arrays`.

    Raises:
        DataError: there is no such file, or it is another one; names the array that does not fit.
    """
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            arrays = {name: _read(archive, name, shape) for name, shape in expected_arrays()}
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name the .npz of LPIPS's weights") from None
    except DAMAGE as error:
        raise DataError(
            f"{path}: not the weights of LPIPS with VGG-16 ({describe_damage(error)}); "
            "name another file"
        ) from None
    layers = range(sum(map(len, BLOCKS)))
    return LpipsWeights(
        tuple(arrays[f"VGG16_0/Conv_{number}/kernel"] for number in layers),
        tuple(arrays[f"VGG16_0/Conv_{number}/bias"] for number in layers),
        tuple(arrays[f"NetLinLayer_{number}/Conv_0/kernel"].ravel() for number in range(5)),
    )


def _read(archive: zipfile.ZipFile, name: str, shape: tuple[int, ...]) -> Array:
    """One array; its header is checked before anything is made of its size."""
    member = f"{name}.npy"
    if member not in archive.namelist():
        raise ValueError(f"array {name} is missing")
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{name}: an array of another version of the format")
        found, _, dtype = np.lib.format.read_array_header_1_0(file)
    if found != shape:
        raise ValueError(f"{name}: shape is {found}, expected {shape}")
    if dtype not in DTYPES:
        raise ValueError(f"{name}: dtype is {dtype}, expected float16 or float32")
    with archive.open(member) as file:
        array = np.lib.format.read_array(file, allow_pickle=False).astype(np.float32)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: a number is not finite")
    return array
