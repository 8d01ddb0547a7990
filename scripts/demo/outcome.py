"""What came out of the demonstration: its numbers, its bar, and its picture."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from picture import Showcase, draw_showcase

from clgs.data.images import list_images
from clgs.errors import DataError
from clgs.exports.image import picture_names, save_png
from clgs.exports.run_report import sections
from clgs.workflow.run_record import measure_data


@dataclass(frozen=True)
class Outcome:
    """The demonstration in numbers.

    folder: of `clgs run`; photos given and registered: counts; scores: as ``clgs eval --json``
    writes them.
    """

    folder: Path
    photos: int
    registered: int
    scores: dict[str, Any]


@dataclass(frozen=True)
class Target:
    """The bar that the demo sets itself on its own photos: share registered, PSNR in dB."""

    registered: float
    psnr: float

    def misses(self, outcome: Outcome) -> list[str]:
        """What falls short, in words; a PSNR that is not a number falls short too."""
        found = []
        if not outcome.registered >= self.registered * outcome.photos:
            share = f"{outcome.registered} of {outcome.photos}"
            found.append(f"{share} photos found their pose, {self.registered:.0%} are needed")
        if not outcome.scores["psnr"] >= self.psnr:
            found.append(f"held-out PSNR {outcome.scores['psnr']:.2f} dB, below {self.psnr:g} dB")
        return found


def gather(folder: Path, photos: Path) -> Outcome:
    """Read the numbers that `clgs run` left in ``folder``."""
    scores = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    registered = measure_data(folder / "data").count
    return Outcome(folder, len(list_images(photos)), registered, scores)


def draw_comparison(path: Path, outcome: Outcome) -> None:
    """The held-out view of median PSNR, neither the best nor the worst, with the file's bytes."""
    scores = outcome.scores["per_view"]
    names = picture_names([score["name"] for score in scores])
    ranked = sorted(zip(scores, names, strict=True), key=lambda pair: float(pair[0]["psnr"]))
    score, name = ranked[len(ranked) // 2]
    photo, render = (_picture(outcome.folder, kind, name) for kind in ("gt", "renders"))
    parts = sections(outcome.folder / "run")
    save_png(path, draw_showcase(Showcase(photo, render, score["psnr"], parts)))


def _picture(folder: Path, kind: str, name: str) -> npt.NDArray[np.uint8]:
    from PIL import Image

    found = next((folder / "run" / "test").glob(f"*/{kind}/{name}"), None)
    if found is None:
        raise DataError(f"{folder / 'run' / 'test'}: no picture {name}; run the demo again")
    with Image.open(found) as picture:
        return np.array(picture.convert("RGB"))
