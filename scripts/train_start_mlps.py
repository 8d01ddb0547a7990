"""Train the MLPs that runs start from: ``python scripts/train_start_mlps.py DATA... -o FILE.npy``.

Each data set in turn trains on from the MLPs of the one before; the first starts from random ones.
Features begin with zeros every time, so that what remains is how to read features, not a scene.
At the end the mean feature joins the biases, so that zeros stand for a mean anchor. ``--objects``
names a second file, of networks that read LIVE features alone: the weights of the others and they
themselves are zeros, and stay so in training.

Those that ship, in ``clgs/train/run``, were made of the photos of the demonstration (``data`` in
its folder), and of a capture of its exhibits:

    python scripts/demo/object_capture.py object
    python scripts/train_start_mlps.py demo object -o trained_mlps.npy --objects object_mlps.npy
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from clgs.constants import FEATURE_DIM, HEAD_DIMS
from clgs.files import atomic_path
from clgs.scene.mlps import Mlps, unpack_head
from clgs.scene.scene import QuantizedScene
from clgs.train.config import preset
from clgs.train.run.load import RANDOM, load_for
from clgs.train.run.session import train_scene

LIVE = 40
"""Features that networks for objects read (docs/benchmarks/sizes.md)."""


def main() -> int:
    """Write the MLPs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="+", metavar="DATA", help="prepared data sets")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.npy")
    parser.add_argument("--objects", type=Path, metavar="FILE.npy", help="of LIVE features")
    parser.add_argument("--steps", type=int, default=3000, help="of every run")
    args = parser.parse_args()
    with TemporaryDirectory() as folder:
        start = RANDOM
        for number, data in enumerate(args.data):
            run = Path(folder) / str(number)
            scene = train(data, start, number, args.steps, run)
            start = str(run / "scene.npz")
    mlps = centred(scene)
    save(args.output, mlps)
    if args.objects:
        save(args.objects, reduced(mlps))
    return 0


def save(path: Path, mlps: Mlps) -> None:
    """Write the weights, atomically."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.save(file, mlps.flat, allow_pickle=False)


def train(data: Path, start: str, seed: int, steps: int, folder: Path) -> QuantizedScene:
    """The scene of one run on ``data`` from the MLPs called ``start``."""
    config = preset("default").scaled(steps)
    config = replace(config, seed=seed, mlp="float32", start_mlps=start)
    folder.mkdir()
    result = train_scene(load_for(config, data, folder), folder, config)
    print(f"{data.name}: {result.summary['psnr']:.2f} dB, {result.summary['bytes']:,} bytes")
    return result.scene


def centred(scene: QuantizedScene) -> Mlps:
    """The scene's MLPs for features from which their mean is taken."""
    mean = (scene.anchors.feature / scene.scales.feature).mean(axis=0)
    mlps = Mlps(scene.mlps.flat.copy())
    for name in HEAD_DIMS:
        head = mlps.head(name)
        shift = head["hidden_weight"][:, :FEATURE_DIM].astype(np.float64) @ mean
        head["hidden_bias"][:] += shift.astype(np.float32)
    return mlps


def reduced(mlps: Mlps) -> Mlps:
    """The MLPs as functions of LIVE features, which keep as much as possible of what they read.

    The features are turned to the directions to which outputs respond most, and among these at
    random, so that all of them matter as much and one step of quantisation suits all.
    """
    heads = [unpack_head(mlps.flat.astype(np.float64), name) for name in HEAD_DIMS]
    response = [
        head["hidden_weight"][:, :FEATURE_DIM]
        * np.linalg.norm(head["output_weight"], axis=0)[:, None]
        for head in heads
    ]
    directions = np.linalg.svd(np.concatenate(response))[2][:LIVE]
    random, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(LIVE, LIVE)))
    found = Mlps(mlps.flat.copy())
    for name, head in zip(HEAD_DIMS, heads, strict=True):
        weight = found.head(name)["hidden_weight"]
        weight[:, LIVE:FEATURE_DIM] = 0
        weight[:, :LIVE] = head["hidden_weight"][:, :FEATURE_DIM] @ directions.T @ random
    return found


if __name__ == "__main__":
    sys.exit(main())
