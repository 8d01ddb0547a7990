"""LPIPS with VGG-16: how different two pictures look, by the activations of a network.

Each of five blocks gives activations of both pictures, scaled to unit length over the channels;
the squares of their differences, weighted by channel, are averaged over the pixels and added up.
Pictures in [0, 1] enter as they are, as in the evaluation of 3DGS and all that came of it, though
the network's first layer was made for [-1, 1]: scores compare within this family alone.

Source: Zhang et al. 2018, version 0.1 of the weights. It runs on ONNX Runtime, an optional extra.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.codec.workers import processors
from clgs.errors import ClgsError, DataError
from clgs.shapes import Shapes
from clgs.train.quality.lpips_weights import BLOCKS, LpipsWeights

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""The first layer: (x - SHIFT) / SCALE, by channel."""

EPSILON = 1e-10
"""Added to the length of a pixel's activations before they are divided by it."""

SMALLEST = 16
"""Pixels: the last of four halvings leaves one."""

OPSET, IR_VERSION = 17, 8
"""Versions of the graph's format, of 2022: any ONNX Runtime since 1.12 reads them."""


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
        """At least 0, and 0 for equal pictures; symmetric. Both (H, W, 3) uint8.

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
    """Collects the nodes of a network; tensors go by their names."""

    def __init__(self, onnx: Any) -> None:
        self._helper, self._tensor = onnx.helper, onnx.numpy_helper.from_array
        self._float = onnx.TensorProto.FLOAT
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def lpips(self, weights: LpipsWeights) -> bytes:
        """From ``render`` and ``photo`` to the map of differences of each block."""
        names = ("render", "photo")
        tensors = [self._normalised(name) for name in names]
        maps, first = [], 0
        for number, block in enumerate(BLOCKS):
            layers = slice(first, first + len(block))
            convolutions = [
                (self._constant(kernel.transpose(3, 2, 0, 1)), self._constant(bias))
                for kernel, bias in zip(
                    weights.kernels[layers], weights.biases[layers], strict=True
                )
            ]
            if number:
                tensors = [
                    self._add("MaxPool", one, kernel_shape=[2, 2], strides=[2, 2])
                    for one in tensors
                ]
            # One picture after the other: each layer of one is gone before the other's is made.
            tensors = [self._convolved(one, convolutions) for one in tensors]
            maps.append(self._difference(tensors, weights.linear[number]))
            first += len(block)
        return self._finished(names, maps)

    def _normalised(self, name: str) -> str:
        shift, scale = (
            self._constant(np.reshape(values, (1, 3, 1, 1))) for values in (SHIFT, SCALE)
        )
        return self._add("Div", self._add("Sub", name, shift), scale)

    def _convolved(self, tensor: str, convolutions: list[tuple[str, str]]) -> str:
        for kernel, bias in convolutions:
            sides = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}
            tensor = self._add("Relu", self._add("Conv", tensor, kernel, bias, **sides))
        return tensor

    def _difference(self, tensors: list[str], linear: npt.NDArray[np.float32]) -> str:
        epsilon = self._constant(np.array(EPSILON))
        units = []
        for tensor in tensors:
            length = self._add("ReduceL2", tensor, axes=[1], keepdims=1)
            units.append(self._add("Div", tensor, self._add("Add", length, epsilon)))
        difference = self._add("Sub", *units)
        square = self._add("Mul", difference, difference)
        kernel = self._constant(linear.reshape(1, -1, 1, 1))
        return self._add("Conv", square, kernel, kernel_shape=[1, 1])

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
