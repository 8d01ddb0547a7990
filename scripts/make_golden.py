"""Write the golden files of the codec's tests: ``python scripts/make_golden.py [FOLDER]``.

The scenes are drawn with integer arithmetic from fixed seeds, so that every machine makes the
same files. The files of a released version are kept and never made again: a test compares bytes.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from clgs.codec.scene_encoder import encode
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene, RenderSettings, SceneTransform

FOLDER = Path(__file__).resolve().parents[1] / "tests" / "codec" / "golden"


def main() -> None:
    """Write every file of ``golden_files`` and the list of hashes."""
    parser = argparse.ArgumentParser(description="Write the golden files of the codec's tests.")
    help = "where to write them (default: tests/codec/golden, where a test compares them)"
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER, metavar="FOLDER", help=help)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in golden_files().items():
        (folder / f"{name}.clgs").write_bytes(data)
        print(f"{name}.clgs: {len(data)} bytes")
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n"
        for path in sorted(folder.glob("*.clgs"))
    ]
    (folder / "SHA256SUMS").write_text("".join(lines), encoding="ascii")


def golden_files() -> dict[str, bytes]:
    """The files by name."""
    return {name: golden_file(name) for name in golden_scenes()}


def golden_file(name: str) -> bytes:
    """One of them."""
    return encode(golden_scenes()[name], **OPTIONS.get(name, {}))


OPTIONS: dict[str, dict[str, Any]] = {
    "chunks": {"chunk": 64},
    "details": {"chunk": 64, "layers": 3, "details": True},
    "fast": {"level": "fast"},
    "layers": {"chunk": 64, "layers": 3},
    "max": {"level": "max"},
    "paper": {"level": "paper"},
    "sided": {"layers": 2, "details": True},
}
"""How a file is encoded, if not by default."""


def golden_scenes() -> dict[str, QuantizedScene]:
    """Scenes by file name; together they take every branch of the format."""
    settings = RenderSettings(background=(0.0, 0.25, 1.0), near=0.5, blur=0.0)
    transform = SceneTransform((-1e-3, 0.0, 3e5), 2.0)
    return {
        "nothing": _scene(np.empty((0, 3), np.int32), 0, 11),
        "single": _scene(np.array([[-(2**31), 5, 0]], np.int32), 3, 12),
        "chunks": _scene(_surface(12), 2, 13, settings, transform),
        "fast": _follow(_scene(_surface(8), 3, 14, settings), 4),
        "default": _follow(_scene(_surface(14) * 3 - 11, 3, 15, None, transform), 1),
        "max": _follow(_scene(_surface(17), 1, 16), 1),
        "paper": _scene(_scattered(), 9, 17),
        "layers": _follow(_scene(_surface(13), 2, 19, settings, transform), 2),
        "details": _follow(_scene(_surface(13), 5, 20, settings, transform), 2),
        "sided": _related(_scene(_surface(17), 5, 21)),
        "deep": _scene(_deep(), 2**31 - 1, 18),
    }


def _surface(edge: int) -> np.ndarray:
    """A bent sheet: edge * edge voxels with neighbours."""
    x, y = np.divmod(np.arange(edge * edge), edge)
    return np.stack([x, y, (x * x + 3 * y) // 8 - 3], 1).astype(np.int32)


def _deep() -> np.ndarray:
    """Eight voxels at the corners of the largest grid, up to the end of int32."""
    corners = np.argwhere(np.ones((2, 2, 2), bool)) * (2**21 - 1)
    return (corners + np.array([2**31 - 2**21, -(2**31), -7])).astype(np.int32)


def _scattered() -> np.ndarray:
    """24 lonely voxels over 2^20 cells."""
    i = np.arange(1, 25, dtype=np.int64)
    return (np.stack([i * 7919, i * i * 104729, i**3 * 1299709], 1) % (1 << 20)).astype(np.int32)


def _scene(
    position: np.ndarray,
    spread: int,
    seed: int,
    settings: RenderSettings | None = None,
    transform: SceneTransform | None = None,
) -> QuantizedScene:
    """A scene with attributes of size up to ``spread`` and a few weights that are not zero."""
    count = len(position)
    draw = _Draw(seed)
    anchors = QuantizedAnchors(
        position,
        draw.peaked(count * K_OFFSETS * 3, spread).reshape(count, K_OFFSETS, 3),
        draw.peaked(count * FEATURE_DIM, spread).reshape(count, FEATURE_DIM),
        draw.peaked(count * 6, min(spread, 2**28) * 4).reshape(count, 6),
    )
    anchors.offset[count // 2 :] *= anchors.offset[count // 2 :, :, :1] & 1  # zero triplets
    for array in (anchors.offset, anchors.feature, anchors.scaling):
        array[count // 3 : count // 2] = 0  # runs of zero rows
    weights = np.zeros(MLP_SIZE, np.float32)
    weights[::29] = draw.peaked(len(weights[::29]), 512) / np.float32(1024)
    return QuantizedScene(
        anchors,
        Mlps(weights),
        QuantizationScales(),
        settings or RenderSettings(),
        transform or SceneTransform(),
    )


def _follow(scene: QuantizedScene, period: int) -> QuantizedScene:
    """The scene with attributes that mostly follow the first of their rows, which drifts."""
    anchors = scene.anchors
    drift = np.cumsum(anchors.feature[:, 0] % 3 - 1)
    for rows in (anchors.feature, anchors.scaling, anchors.offset.reshape(len(anchors), -1)):
        change = rows % 3 - 1
        change[:, np.arange(rows.shape[1]) % (4 * period) != 0] = 0
        rows[:] = drift[:, None] // 2 * (np.arange(rows.shape[1]) % 2) + change
    return scene


def _related(scene: QuantizedScene) -> QuantizedScene:
    """The scene with features near three times the first of their row, and little else."""
    anchors = scene.anchors
    anchors.feature[:, 1:] = 3 * anchors.feature[:, :1] + anchors.feature[:, 1:] % 5 - 2
    anchors.feature[:, 12:], anchors.offset[:], anchors.scaling[:] = 0, 1, -30
    return scene


class _Draw:
    """Integers from a 64-bit multiplicative generator (Knuth's MMIX constants)."""

    def __init__(self, seed: int) -> None:
        self.state = seed

    def uniform(self, count: int) -> np.ndarray:
        """``count`` integers (count,) int64 in [0, 2^32)."""
        numbers = []
        for _ in range(count):
            self.state = (self.state * 6364136223846793005 + 1442695040888963407) % (1 << 64)
            numbers.append(self.state >> 32)
        return np.array(numbers, np.int64)

    def peaked(self, count: int, spread: int) -> np.ndarray:
        """``count`` int32 in [-spread - 1, spread], small ones most often."""
        first, second = self.uniform(count) - 2**31, self.uniform(count)
        return ((first * (second >> 1) >> 31) * spread >> 31).astype(np.int32)


if __name__ == "__main__":
    main()
