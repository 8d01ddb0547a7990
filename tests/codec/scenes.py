"""Scenes for the codec's tests."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np

from clgs.scene.anchors import QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = Path(__file__).resolve().parent / "golden"


def make_golden() -> ModuleType:
    """The module ``scripts/make_golden.py``."""
    spec = importlib.util.spec_from_file_location("make_golden", ROOT / "scripts/make_golden.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def random_scene(rng: np.random.Generator, count: int = 50) -> QuantizedScene:
    """About ``count`` anchors in a small box, rows in random order, few non-zero weights."""
    position = np.unique(rng.integers(-9, 9, (count, 3)), axis=0).astype(np.int32)
    count = len(position)
    anchors = QuantizedAnchors(
        rng.permutation(position),
        np.rint(rng.laplace(0, 1, (count, 10, 3))).astype(np.int32),
        np.rint(rng.laplace(0, 2, (count, 50))).astype(np.int32),
        np.rint(rng.laplace(-30, 8, (count, 6))).astype(np.int32),
    )
    weights = np.zeros(MLP_SIZE, np.float32)
    weights[::40] = rng.normal(size=len(weights[::40]))
    return QuantizedScene(anchors, Mlps(weights))


def assert_same(a: QuantizedScene, b: QuantizedScene) -> None:
    """Every integer, weight and setting alike; rows in the same order."""
    for name in ("position", "offset", "feature", "scaling"):
        np.testing.assert_array_equal(getattr(a.anchors, name), getattr(b.anchors, name))
    np.testing.assert_array_equal(a.mlps.flat.view(np.uint32), b.mlps.flat.view(np.uint32))
    assert (a.scales, a.settings, a.transform) == (b.scales, b.settings, b.transform)
