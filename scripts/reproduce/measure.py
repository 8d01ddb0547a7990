"""The row of a trained scene: scores, sizes and times, of its file alone."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.data.dataset import Dataset
from clgs.lab.figures import machine_facts, take_turns
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.train.quality.scores import evaluate_views, summarize
from clgs.train.state.hashes import scene_hash

TIMES = 3
"""Runs of encoding and decoding, of which the median is taken."""


def measure(file: Path, dataset: Dataset, device: Device, options: RenderOptions) -> dict[str, Any]:
    """All that is measured on a ``.clgs`` file after training, ready for JSON."""
    data = file.read_bytes()
    scene = decode(data)
    coders = {"encode": partial(encode, scene), "decode": partial(decode, data)}
    times = take_turns(coders, TIMES)
    views = dataset.test or dataset.train
    scores = evaluate_views(device, scene, views, options=options)
    summary = summarize(scene, scores, len(data))
    names = ("protocol", "views", "psnr", "psnr_channel_mean", "ssim", "bytes", "anchors")
    return {
        **{name: summary[name] for name in names},
        "split": "test" if dataset.test else "train",
        "sections": describe(data)["sections"],
        "sha256": hashlib.sha256(data).hexdigest(),
        "scene_hash": scene_hash(scene),
        "encodes_alike": encode(scene) == data,
        **{f"{name}_seconds": median(each) / 1e3 for name, each in times.items()},
        "pictures_per_second": 1.0 / median(score.seconds for score in scores),
        "scales": dict(vars(scene.scales)),
        "machine": machine_facts(device),
    }
