"""LPIPS with VGG-16: how different two pictures look, by the activations of a network.

Each of five blocks gives activations of both pictures, scaled to unit length over the channels;
the squares of their differences, weighted by channel, are averaged over the pixels and added up.
Pictures in [0, 1] enter as they are, as in the evaluation of 3DGS and all that came of it, though
the network's first layer was made for [-1, 1]: scores compare within this family alone.

Source: Zhang et al. 2018, version 0.1 of the weights. It runs on ONNX Runtime, an optional extra.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError, DataError
from clgs.machine import processors
from clgs.scene.storage import DAMAGE, check_members, describe_damage
from clgs.shapes import Shapes

BLOCKS = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Output channels of the convolutions of VGG-16 (Simonyan and Zisserman 2015), block by block."""

DTYPES = (np.dtype(np.float16), np.dtype(np.float32))

Array = npt.NDArray[np.float32]

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""The first layer: (x - SHIFT) / SCALE, by channel."""

EPSILON = 1e-10
"""Added to the length of a pixel's activations before they are divided by it."""

SMALLEST = 16
"""Pixels: the last of four halvings leaves one."""

OPSET, IR_VERSION = 17, 8
"""Versions of the graph's format, of 2022: any ONNX Runtime since 1.12 reads them."""


@dataclass(frozen=True)
class LpipsWeights:
    """All float32.

    kernels, biases: of each convolution (3, 3, inputs, outputs) and (outputs,), in the order of the
    network; linear: of each block (channels,), what the square of a difference counts.
    """

    kernels: tuple[Array, ...]
    biases: tuple[Array, ...]
    linear: tuple[Array, ...]


class Lpips:
    """The network, ready to compare pictures: ``lpips(render, photo)``."""

    def __init__(self, weights: LpipsWeights) -> None:
        """Build the network, for all processors that this process may use.

        Raises:
            ClgsError: onnx or onnxruntime is not installed.
        """
        onnx, runtime = require_onnx()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = processors()
        options.enable_mem_pattern = False  # it holds a second copy of all activations
        # Threads that wait must not take the processor from other programs.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        model = _Graph(onnx).lpips(weights)
        providers = ["CPUExecutionProvider"]
        self._session = runtime.InferenceSession(model, options, providers=providers)

    def __call__(self, render: npt.NDArray[np.uint8], photo: npt.NDArray[np.uint8]) -> float:
        """How different two pictures (H, W, 3) uint8 look: at least 0, 0 for equal ones; symmetric.

        Raises:
            ValueError, TypeError: of another shape or dtype.
            DataError: a side is shorter than SMALLEST pixels.
        """
        shapes = Shapes()
        shapes.check("render", render, "H W 3", np.uint8)
        shapes.check("photo", photo, "H W 3", np.uint8)
        if min(photo.shape[:2]) < SMALLEST:
            height, width = photo.shape[:2]
            raise DataError(
                f"photo of {width}x{height}: LPIPS needs {SMALLEST}x{SMALLEST} pixels; "
                "take a smaller --downscale"
            )
        maps = self._session.run(None, {"render": _planar(render), "photo": _planar(photo)})
        return float(sum(one.mean(dtype=np.float64) for one in maps))


def require_onnx() -> tuple[Any, Any]:
    """The modules onnx, which describes the network, and onnxruntime, which runs it.

    Raises:
        ClgsError: one of them is not installed.
    """
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise ClgsError(
            f'LPIPS needs onnx and onnxruntime ({error}): pip install "clgs[lpips]"'
        ) from None
    return onnx, onnxruntime


def _planar(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """(1, 3, H, W) float32 in [0, 1]."""
    return np.ascontiguousarray(picture.transpose(2, 0, 1)[None] / np.float32(255.0))


class _Graph:
    """Collects the nodes of a network; tensors are known by their names."""

    def __init__(self, onnx: Any) -> None:
        self._helper, self._tensor = onnx.helper, onnx.numpy_helper.from_array
        self._float = onnx.TensorProto.FLOAT
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def lpips(self, weights: LpipsWeights) -> bytes:
        """The network that makes, of ``render`` and ``photo``, the map of differences per block."""
        names = ("render", "photo")
        shift, scale = (self._constant(np.reshape(v, (1, 3, 1, 1))) for v in (SHIFT, SCALE))
        epsilon = self._constant(np.array(EPSILON))
        tensors = [self._add("Div", self._add("Sub", name, shift), scale) for name in names]
        layers, maps = iter(zip(weights.kernels, weights.biases, strict=True)), []
        for number, block in enumerate(BLOCKS):
            convolutions = [
                (self._constant(kernel.transpose(3, 2, 0, 1)), self._constant(bias))
                for _, (kernel, bias) in zip(block, layers, strict=False)
            ]
            units = []
            for index, tensor in enumerate(tensors):
                if number:
                    tensor = self._add("MaxPool", tensor, kernel_shape=[2, 2], strides=[2, 2])
                # One picture after the other: each layer of one is gone before the other's is made.
                for kernel, bias in convolutions:
                    sides = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}
                    tensor = self._add("Relu", self._add("Conv", tensor, kernel, bias, **sides))
                tensors[index] = tensor
            for tensor in tensors:
                length = self._add("ReduceL2", tensor, axes=[1], keepdims=1)
                units.append(self._add("Div", tensor, self._add("Add", length, epsilon)))
            difference = self._add("Sub", *units)
            square = self._add("Mul", difference, difference)
            linear = self._constant(weights.linear[number].reshape(1, -1, 1, 1))
            maps.append(self._add("Conv", square, linear, kernel_shape=[1, 1]))
        return self._finished(names, maps)

    def _constant(self, values: npt.NDArray[Any]) -> str:
        name = f"constant{len(self._constants)}"
        self._constants.append(self._tensor(np.ascontiguousarray(values, np.float32), name))
        return name

    def _add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        name = f"tensor{len(self._nodes)}"
        self._nodes.append(self._helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def _finished(self, inputs: tuple[str, ...], outputs: list[str]) -> bytes:
        def described(names: Any, channels: int) -> list[Any]:
            shape = [1, channels, None, None]
            return [self._helper.make_tensor_value_info(name, self._float, shape) for name in names]

        graph = self._helper.make_graph(
            self._nodes, "lpips", described(inputs, 3), described(outputs, 1), self._constants
        )
        opsets = [self._helper.make_opsetid("", OPSET)]
        model = self._helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION)
        return bytes(model.SerializeToString())


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
            check_members(archive, path.stat().st_size)
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
