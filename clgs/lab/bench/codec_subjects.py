"""What ``clgs bench codec`` measures: seeded arrays, or those of files."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgs.codec import morton_order
from clgs.codec.scene_decoder import decode
from clgs.codec.streams import check_integers
from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.errors import CodecError, DataError
from clgs.scene.anchors import QuantizationScales, QuantizedAnchors
from clgs.scene.mlps import MLP_SIZE, Mlps
from clgs.scene.scene import QuantizedScene
from clgs.scene.storage import load_archive

Ints = npt.NDArray[np.int32]

ANCHORS, QUICK_ANCHORS = 312_238, 20_000
"""The mean of a published data set, and a size that takes seconds."""

KINDS = (".npz", ".clgs")

SPREADS = {"offset": 0.57, "feature": 0.96, "scaling": 6.0}
"""Scales of the Laplace distributions: 1.73, 2.43 and 5.03 bits a number once rounded, near the
1.68, 2.35 and 5.05 of the published data set."""


PUBLISHED_ATTRIBUTES = {
    "iid_offset": 252375,
    "iid_feat": 588078,
    "iid_scale": 151649,
    "chan_feat": 530467,
    "zi_offset": 239515,
    "corr_weak": 556432,
    "corr_scale": 144476,
    "biker_scale_q8": 324445,
    "biker_color": 469109,
}
"""Bytes of known arrays by G-PCC's attribute residual coder as the paper's code calls it."""

PUBLISHED_POSITIONS = {
    "scene_q200": 484946,
    "armadillo_sparse_1024": 51899,
    "armadillo_dense_1024": 242340,
    "bunny_4096": 464382,
    "bunny_noisy_2048": 534403,
    "biker_1628": 160897,
    "biker_407": 49801,
}
"""Bytes of known clouds by G-PCC tmc13 v23: lossless octree geometry, the paper's settings."""


@dataclass(frozen=True)
class CodedData:
    """What is coded: ``content`` rows (N, channels) or positions (N, 3) int32, or a scene."""

    name: str
    kind: str  # attributes, positions or scene
    content: Ints | QuantizedScene

    @property
    def symbols(self) -> int:
        """Numbers of attributes, points of positions, anchors of a scene."""
        if isinstance(self.content, QuantizedScene):
            return len(self.content.anchors)
        return self.content.size if self.kind == "attributes" else len(self.content)

    @property
    def baseline(self) -> int | None:
        """Bytes of the published coder, if they are known."""
        known = {"attributes": PUBLISHED_ATTRIBUTES, "positions": PUBLISHED_POSITIONS}
        return known.get(self.kind, {}).get(self.name)


def seeded_subjects(anchors: int, seed: int) -> list[CodedData]:
    """Independent Laplace numbers, points on bent sheets, and the scene of both."""
    return scene_subjects("seeded", seeded_scene(anchors, seed))


def seeded_scene(anchors: int, seed: int) -> QuantizedScene:
    """A scene of about ``anchors`` anchors in Morton order."""
    rng = np.random.default_rng(seed)
    # voxels of three noisy bent sheets, unique, in Morton order
    side = int(np.sqrt(2 * anchors)) + 2
    u, v = rng.uniform(-1, 1, (2, 2 * anchors))
    sheet = rng.integers(0, 3, 2 * anchors)
    height = 0.3 * np.sin(3 * u + sheet) * np.cos(2 * v) + 0.4 * sheet
    points = np.stack([u, v, height + rng.normal(0, 0.002, len(u))], 1)
    position = np.unique(np.rint(points * side / 2).astype(np.int32), axis=0)
    position = rng.permutation(position)[:anchors]
    position = position[morton_order(position)]
    count = len(position)

    def draw(kind: str, channels: int) -> Ints:
        return np.rint(rng.laplace(0, SPREADS[kind], (count, channels))).astype(np.int32)

    quantised = QuantizedAnchors(
        position,
        draw("offset", 3 * K_OFFSETS).reshape(count, K_OFFSETS, 3),
        draw("feature", FEATURE_DIM),
        draw("scaling", 6),
    )
    weights = np.rint(rng.laplace(0, 100, MLP_SIZE)).astype(np.float32) / np.float32(1024)
    return QuantizedScene(quantised, Mlps(weights), QuantizationScales())


def scene_subjects(name: str, scene: QuantizedScene) -> list[CodedData]:
    """The parts of a scene, each alone, and the whole file."""
    a = scene.anchors
    parts = {"offset": a.offset.reshape(len(a), 3 * K_OFFSETS), "feature": a.feature}
    parts["scaling"] = a.scaling
    return [
        *[CodedData(f"{name} {part}", "attributes", rows) for part, rows in parts.items()],
        CodedData(f"{name} position", "positions", a.position),
        CodedData(f"{name} file", "scene", scene),
    ]


def file_subjects(paths: Iterable[Path]) -> list[CodedData]:
    """Read .npz files (``values`` or ``positions``) and .clgs files; folders mean their files.

    Raises:
        DataError: no such file, or none of these kinds.
    """
    found: list[CodedData] = []
    for path in paths:
        files = (
            [f for f in path.iterdir() if f.suffix.lower() in KINDS] if path.is_dir() else [path]
        )
        if not files:
            raise DataError(f"{path}: no .npz or .clgs files; name a folder that has some")
        for file in sorted(files):
            found += _read(file)
    return found


def _read(file: Path) -> list[CodedData]:
    try:
        if file.suffix.lower() == ".clgs":
            return scene_subjects(file.stem, decode(file.read_bytes()))
        with file.open("rb") as opened, load_archive(opened) as arrays:
            name = "positions" if "positions" in arrays else "values"
            rows = arrays[name]
    except OSError as error:
        raise DataError(f"{file}: {error.strerror or error}; name a .npz or .clgs file") from error
    except CodecError as error:
        raise DataError(f"{file}: {error}") from error
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        problem = "is no .npz archive with `values` or `positions`, and no .clgs file"
        raise DataError(f"{file}: {problem}; name another") from error
    if rows.ndim != 2 or rows.dtype.kind not in "iu":
        raise DataError(f"{file}: {name} is {rows.dtype} {rows.shape}; (N, channels) integers")
    try:
        rows = check_integers(name, rows)
    except CodecError as error:
        raise DataError(f"{file}: {error}") from error
    if name == "values":
        return [CodedData(file.stem, "attributes", rows)]
    return [CodedData(file.stem, "positions", rows[morton_order(rows)])]
