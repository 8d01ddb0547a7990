"""A scene as one web page: its file, the decoder as WebAssembly, and a viewer, in one HTML file.

The parts lie in ``web/``: ``page`` is text, ``wasm`` is C that the package's build compiles to
``scene.wasm`` if it finds a compiler for WebAssembly. A page that holds its scene loads nothing
from elsewhere.
"""

from __future__ import annotations

import base64
import importlib.resources
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape

import numpy as np

from clgs import constants
from clgs.errors import ClgsError
from clgs.files import text_bytes
from clgs.scene.camera import Camera, optical_axes

SCRIPTS = ("camera.js", "hands.js", "renderer.js", "main.js")
"""The files that are one script, in this order."""

LEAST_DISTANCE = 0.2
"""The least distance of the target from the first view, as a share of that view's
distance from the middle of all."""


@dataclass(frozen=True)
class Start:
    """Where a page starts, in scene units; ``fov``: of the longer side of the window, radians."""

    eye: tuple[float, ...]
    target: tuple[float, ...]
    up: tuple[float, ...]
    fov: float


def scene_page(
    data: bytes, title: str, start: Start | None = None, address: str | None = None
) -> bytes:
    """The page that shows a .clgs file, all of ``data``; without it one to drop such files on.

    The page verifies the file. It begins at ``start``, or guesses a view. A page without ``data``
    reads the file at ``address``, relative to its own, or else the one that ``?scene=ADDRESS``
    names; layers are shown as they come.

    Raises:
        ClgsError: the package was built without the decoder.
    """
    settings = {
        "title": title,
        "start": asdict(start) if start else None,
        "address": address,
        "margin": constants.FRUSTUM_MARGIN,
    }
    values = {
        "title": escape(title or "clgs viewer"),
        "settings": json.dumps(settings).replace("<", "\\u003c"),
        "wasm": base64.b64encode(_decoder()).decode(),
        "scene": base64.b64encode(data).decode(),
        "scripts": "\n".join(_text(name) for name in SCRIPTS),
        "page.css": _text("page.css"),
        "worker": _text("worker.js") + ("" if data else "\n\n" + _text("stream.js")),
    }
    page = re.sub(r"\{\{([\w.]+)\}\}", lambda match: values[match[1]], _text("page.html"))
    return text_bytes(page)


def start_at(first: Camera, cameras: Sequence[Camera]) -> Start:
    """A start at ``first``, upright as ``cameras`` are on average.

    The target lies on the axis of ``first``, where it comes nearest to the axes of all.
    """
    up = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
    centres = np.array([camera.centre for camera in cameras])
    away = float(np.linalg.norm(first.centre - centres.mean(axis=0)))
    matrix, right = optical_axes(centres, np.array([camera.rotation[2] for camera in cameras]))
    meeting, forward = np.linalg.solve(matrix + 1e-6 * np.eye(3), right), first.rotation[2]
    depth = max(float((meeting - first.centre) @ forward), LEAST_DISTANCE * away, 1e-3)
    side = max(first.width / first.fx, first.height / first.fy)
    return Start(
        tuple(first.centre.tolist()),
        tuple((first.centre + depth * forward).tolist()),
        tuple(up.tolist()),
        float(2 * np.arctan(0.5 * side)),
    )


def _decoder() -> bytes:
    decoder = importlib.resources.files("clgs") / "web" / "scene.wasm"
    if not decoder.is_file():
        raise ClgsError(
            "clgs was built without the page's decoder; install clang with lld, or `pip install "
            "ziglang`, and install clgs again"
        )
    return decoder.read_bytes()


def _text(name: str) -> str:
    folder = importlib.resources.files("clgs") / "web" / "page"
    return (folder / name).read_text(encoding="utf-8").strip()
