"""The row of a trained scene: scores, sizes and times, of its file alone."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.data.dataset import Dataset
from clgs.lab.facts import machine_facts
from clgs.opencl.device import Device
from clgs.ops import rate
from clgs.options import RenderOptions
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.score_views import evaluate_views, summarize
from clgs.train.rate.entropy import coded_bits, entropy_bits
from clgs.train.state.hashes import scene_hash

Result = TypeVar("Result")

ATTRIBUTES = {"offset": "OFFS", "feature": "FEAT", "scaling": "SCAL"}
"""What the rate proxy estimates, and the section of the file that holds it."""

LEVELS = ("paper", "default")
"""Levels of the encoder that the proxy is compared with."""

FORMS: tuple[rate.Form, ...] = ("channel", "pooled")
"""Of the rate proxy, whose gradient training follows."""

ESTIMATES = ("classes", "entropy", *FORMS)
"""Of bits: as training shows them, by the channels' frequencies alone, and by the proxy."""

TIMES = 3
"""Encoding and decoding take the median of so many."""

REACH, TAIL = 64, 0.999
"""A histogram shows integers that hold this share of all, and at most so many on either side."""

Integers = npt.NDArray[np.int32]
Floats = npt.NDArray[np.float64]


def measure(file: Path, dataset: Dataset, device: Device, options: RenderOptions) -> dict[str, Any]:
    """All that is measured on a ``.clgs`` file after training, ready for JSON."""
    data = file.read_bytes()
    decode_seconds, scene = timed(lambda: decode(data))
    encode_seconds, again = timed(lambda: encode(scene))
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
        "encodes_alike": again == data,
        "encode_seconds": encode_seconds,
        "decode_seconds": decode_seconds,
        "pictures_per_second": 1.0 / median(score.seconds for score in scores),
        "bits": bits(device, scene),
        "histograms": {name: histogram(rows) for name, rows in integers(scene).items()},
        "scales": dict(vars(scene.scales)),
        "machine": machine_facts(device),
    }


def timed(work: Callable[[], Result]) -> tuple[float, Result]:
    """The median of TIMES runs of ``work``, seconds, and what it gave."""
    seconds = []
    for _ in range(TIMES):
        start = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - start)
    return median(seconds), result


def bits(device: Device, scene: QuantizedScene) -> dict[str, dict[str, float]]:
    """Bits of every attribute of a whole scene.

    As both forms of the rate proxy estimate them, ``proxy_channel`` and ``proxy_pooled``, by the
    channels' frequencies (``proxy_entropy``), by those in classes of anchors (``proxy_classes``,
    what training shows), and as the encoder's levels ``paper`` and ``default`` write them.
    """
    anchors, count = scene.dequantize().anchors, len(scene.anchors)
    found: dict[str, dict[str, float]] = {}
    arrays = {name: device.upload(getattr(anchors, name)) for name in ATTRIBUTES} if count else {}
    for form in FORMS:
        found[f"proxy_{form}"] = {
            name: count * rate.forward(device, array, getattr(scene.scales, name), form).bits
            for name, array in arrays.items()
        }
    rows = integers(scene)
    found["proxy_classes"] = coded_bits(rows) if count else {}
    found["proxy_entropy"] = {name: entropy_bits(rows[name]) for name in rows if count}
    for level in LEVELS:
        sections = describe(encode(scene, level))["sections"]
        found[level] = {name: 8.0 * sections[tag] for name, tag in ATTRIBUTES.items()}
    return found


def integers(scene: QuantizedScene) -> dict[str, Integers]:
    """The integers (anchors, channels) of every attribute."""
    count = len(scene.anchors)
    return {name: getattr(scene.anchors, name).reshape(count, -1) for name in ATTRIBUTES}


def histogram(rows: Integers) -> dict[str, Any]:
    """Shares of the integers of an attribute, all channels together, beside Laplace laws.

    Keys: first (the integer of the first share), share, pooled (one law for all) and channel (the
    mean of a law for each channel), lists of equal length; outside (the share of integers beyond).
    A law has the mean of its integers, and b = standard deviation / sqrt(2), as the rate proxy.
    """
    if not rows.size:
        return {"first": 0, "share": [], "pooled": [], "channel": [], "outside": 0.0}
    centre = int(np.rint(rows.mean()))
    reach = int(np.clip(np.quantile(np.abs(rows - centre), TAIL), 1, REACH))
    values = np.arange(centre - reach, centre + reach + 1)
    shares = np.array([(rows == value).mean() for value in values])
    pooled = laplace_mass(values, np.array([rows.mean()]), np.array([rows.std()]))
    channel = laplace_mass(values, rows.mean(axis=0), rows.std(axis=0))
    return {
        "first": int(values[0]),
        "share": shares.tolist(),
        "pooled": pooled.tolist(),
        "channel": channel.tolist(),
        "outside": float(1.0 - shares.sum()),
    }


def laplace_mass(values: npt.NDArray[np.int64], mean: Floats, deviation: Floats) -> Floats:
    """Mass (V,) that the laws (C,) give to [v - 1/2, v + 1/2], their mean."""
    edges = np.append(values - 0.5, values[-1] + 0.5)[:, None] - mean
    b = np.maximum(deviation, 1e-9) / np.sqrt(2.0)
    tail = 0.5 * np.exp(-np.abs(edges) / b)
    below = np.where(edges < 0, tail, 1.0 - tail)
    return np.asarray(np.diff(below, axis=0).mean(axis=1))
