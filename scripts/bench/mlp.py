"""Time of the decoding MLPs against NumPy: ``python scripts/bench/mlp.py [--anchors N]``.

NumPy computes the same numbers in float32 in its best form: inputs gathered into one matrix, one
product for the three hidden layers, one per output layer, in blocks that stay in the cache, into
arrays made before, biases in the products. All take turns. Each timed call follows untimed calls
of the same kind, as the threads of a BLAS spin for a tenth of a second after a call and disturb the
next. Medians are printed. GFLOP counts the products that the method needs: two per weight and
sample forward, four backward (what a pass computes again is not counted).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median

import numpy as np
import numpy.typing as npt

from clgs.constants import FEATURE_DIM, HEAD_DIMS, HIDDEN_DIM, INPUT_DIM, K_OFFSETS, OUTPUT_DIM
from clgs.lab.bench.ops import measure_limits
from clgs.lab.figures import take_turns
from clgs.lab.scenes import camera_of
from clgs.opencl.device import Device
from clgs.ops import mlp
from clgs.options import DEFAULT, RenderOptions, Skips
from clgs.scene.anchors import DeviceAnchors
from clgs.scene.camera import Camera
from clgs.scene.mlps import init_mlps, unpack_head

Array = npt.NDArray[np.float32]
FORWARD_FLOP = 2 * (len(HEAD_DIMS) * INPUT_DIM * HIDDEN_DIM + OUTPUT_DIM * HIDDEN_DIM)

ALL = RenderOptions(skips=Skips(opacity_first=False, slots=False))
MINE = "kernels, all outputs"
BLOCKS = (1024, 4096)
"""Anchors that NumPy takes at a time, in addition to all of them at once."""

WARM_UP = 0.15
"""Seconds of untimed calls."""

UNITS = [slice(i * (HIDDEN_DIM + 1), (i + 1) * (HIDDEN_DIM + 1)) for i in range(len(HEAD_DIMS))]
"""Columns of the hidden layer that belong to a head; the last of each head is always 1."""


@dataclass(frozen=True)
class Case:
    """Anchors, of which all are visible, and the weights."""

    feature: Array
    position: Array
    visible: npt.NDArray[np.int32]
    weights: Array
    camera: Camera


def make_case(count: int) -> Case:
    """``count`` seeded anchors before a camera."""
    rng = np.random.default_rng(0)
    return Case(
        rng.normal(size=(count, FEATURE_DIM)).astype(np.float32),
        rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        np.arange(count, dtype=np.int32),
        init_mlps(rng).flat,
        camera_of(400, 400),
    )


class NumpyHeads:
    """The three heads in float32 NumPy, sample-major, block by block."""

    def __init__(self, case: Case, block: int) -> None:
        """Gather the weights and make the arrays that every call fills."""
        self.case, self.block = case, min(block, len(case.visible))
        layers = {name: unpack_head(case.weights, name) for name in HEAD_DIMS}
        one = np.eye(1, INPUT_DIM + 1, INPUT_DIM, dtype=np.float32)
        hidden = [
            part
            for w in layers.values()
            for part in (np.c_[w["hidden_weight"], w["hidden_bias"]], one)
        ]
        outer = [np.c_[w["output_weight"], w["output_bias"]] for w in layers.values()]
        self.inner = np.ascontiguousarray(np.concatenate(hidden).T)  # (54, 3 x 51)
        self.outer = [np.ascontiguousarray(w.T) for w in outer]  # (51, outputs), bias last
        self.x = np.ones((len(case.visible), INPUT_DIM + 1), np.float32)
        self.hidden = np.empty((len(case.visible), self.inner.shape[1]), np.float32)
        self.output = [np.empty((len(case.visible), n), np.float32) for n in HEAD_DIMS.values()]
        self.d_feature = np.zeros_like(case.feature)

    def forward(self) -> list[Array]:
        """Outputs (V, 10), (V, 30), (V, 70)."""
        centre = self.case.camera.centre.astype(np.float32)
        for start in range(0, len(self.case.visible), self.block):
            part = slice(start, start + self.block)
            rows, x, hidden = self.case.visible[part], self.x[part], self.hidden[part]
            np.take(self.case.feature, rows, axis=0, out=x[:, :FEATURE_DIM])
            step = self.case.position[rows] - centre
            step /= np.sqrt(np.einsum("ij,ij->i", step, step))[:, None]
            x[:, FEATURE_DIM:INPUT_DIM] = step
            np.matmul(x, self.inner, out=hidden)
            np.maximum(hidden, 0, out=hidden)
            for head, weight in enumerate(self.outer):
                np.matmul(hidden[:, UNITS[head]], weight, out=self.output[head][part])
            opacity, color = self.output[0][part], self.output[1][part]
            np.tanh(opacity, out=opacity)
            np.negative(color, out=color)
            np.exp(color, out=color)
            color += 1
            np.reciprocal(color, out=color)
        return self.output

    def backward(self, d_output: list[Array]) -> tuple[Array, list[Array], Array]:
        """Gradients by hidden weights (54, 153), output weights and features, after forward."""
        d_inner = np.zeros_like(self.inner)
        d_outer = [np.zeros_like(w) for w in self.outer]
        for start in range(0, len(self.case.visible), self.block):
            part = slice(start, start + self.block)
            hidden = self.hidden[part]
            d_hidden = np.empty_like(hidden)
            for head, weight in enumerate(self.outer):
                d_sum, y = d_output[head][part], self.output[head][part]
                if head < 2:
                    d_sum = d_sum * (1 - y * y if head == 0 else y - y * y)
                d_outer[head] += hidden[:, UNITS[head]].T @ d_sum
                np.matmul(d_sum, weight.T, out=d_hidden[:, UNITS[head]])
            d_hidden *= hidden > 0
            d_inner += self.x[part].T @ d_hidden
            rows = self.case.visible[part]
            self.d_feature[rows] = d_hidden @ self.inner[:FEATURE_DIM].T
        return d_inner, d_outer, self.d_feature


def main() -> int:
    """Print tables: what, milliseconds, GFLOP/s; the ratio is that of the same outputs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--anchors", type=int, default=50000, help="all of them visible")
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument("--device")
    args = parser.parse_args()
    device, case = Device(args.device), make_case(args.anchors)
    anchors = DeviceAnchors(
        position=device.upload(case.position),
        offset=device.zeros((args.anchors, K_OFFSETS, 3)),
        feature=device.upload(case.feature),
        scaling=device.zeros((args.anchors, 6)),
    )
    camera = device.upload(case.camera.pack(0.2))
    inputs = mlp.Inputs(anchors, device.upload(case.weights), camera)
    visible = device.upload(case.visible)

    def forward(options: RenderOptions) -> mlp.Activations:
        """Run the kernels and wait."""
        result = mlp.forward(device, inputs, visible, options)
        device.finish()
        return result

    def backward(activations: mlp.Activations) -> None:
        """Run the kernels and wait."""
        mlp.backward(device, inputs, activations, d_output)
        device.finish()

    numpy_heads = {f"NumPy, blocks of {n}": NumpyHeads(case, n) for n in (args.anchors, *BLOCKS)}
    full, drawn = forward(ALL), forward(DEFAULT)
    columns = device.download(full.visible)
    for one in numpy_heads.values():
        expected = np.concatenate(one.forward(), axis=1)[columns].T
        error = np.abs(device.download(full.output)[:, : len(columns)] - expected).max()
        assert error <= 1e-5, f"the outputs differ by {error}"
    d_host = np.random.default_rng(1).normal(size=full.output.shape).astype(np.float32)
    d_output = device.upload(d_host)
    splits = np.cumsum(list(HEAD_DIMS.values()))[:-1]
    d_heads = [np.ascontiguousarray(d.T) for d in np.split(d_host[:, : args.anchors], splits)]
    peak = measure_limits(device).flops_per_second / 1e9
    print(f"{device.name}, {args.anchors} visible anchors; peak {peak:.0f} GFLOP/s")
    forwards: dict[str, Callable[[], object]] = {
        MINE: partial(forward, ALL),
        "kernels, drawn slots": partial(forward, DEFAULT),
        **{name: one.forward for name, one in numpy_heads.items()},
    }
    backwards: dict[str, Callable[[], object]] = {
        MINE: partial(backward, full),
        "kernels, drawn slots": partial(backward, drawn),
        **{name: partial(one.backward, d_heads) for name, one in numpy_heads.items()},
    }
    for title, tasks, flop in (
        ("forward", forwards, FORWARD_FLOP),
        ("backward", backwards, 2 * FORWARD_FLOP),
    ):
        found = take_turns(tasks, args.repeats, 0, WARM_UP)
        times = {name: median(each) for name, each in found.items()}
        print(f"{title:36}{'ms':>8}{'GFLOP/s':>9}")
        for name, milliseconds in times.items():
            rate = flop * args.anchors / milliseconds / 1e6
            print(f"  {name:34}{milliseconds:8.2f}{rate:9.0f}")
        best = min(times[name] for name in numpy_heads)
        print(f"  NumPy's best / {MINE}: {best / times[MINE]:.2f}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
