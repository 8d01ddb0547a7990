#!/usr/bin/env python3
"""The web page of a run in headless Chromium: page.py RUN [--seconds S].

Prints the bytes of the page and of the file, the PSNR of screenshots against our own
pictures of the first held-out views, and, while a mouse turns the camera, pictures and sets of
Gaussians per second. Without a GPU Chromium draws by software.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from clgs.exports.page import scene_page
from clgs.render.renderer import render_view
from clgs.scene.camera import Camera
from clgs.train.quality.scores import to_8bit
from clgs.workflow.options import ViewOptions
from clgs.workflow.scenes import read_run
from clgs.workflow.views import select_views
from tests.web.browser import Browser, find_browser

VIEWS = 3
WINDOW = 400
"""Pixels along a side, while the camera moves."""


def main() -> None:
    """Parse the arguments, open the page and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder of a finished training")
    parser.add_argument("--seconds", type=float, default=10.0, help="for which the camera turns")
    args = parser.parse_args()
    program = find_browser()
    if program is None:
        sys.exit("page.py: no Chromium; install chromium-headless-shell, or set CLGS_CHROMIUM")
    data = (args.run / "scene.clgs").read_bytes()
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:  # the browser may still write
        file = Path(folder) / "scene.html"
        file.write_bytes(scene_page(data, args.run.name))
        size = file.stat().st_size
        beyond = size - 1.4 * len(data)
        print(f"page {size:,} bytes, file {len(data):,}; beyond 1.4 times the file {beyond:,.0f}")
        browser = Browser(program, Path(folder) / "profile")
        try:
            show(browser, file, args)
        finally:
            browser.close()


def show(browser: Browser, file: Path, args: argparse.Namespace) -> None:
    """Open the page; screenshots first, then motion."""
    scene = read_run(args.run)[0]
    views = select_views(args.run, scene, ViewOptions(split="test"))
    state = browser.load(file, 1600)
    same = state["hash"] == state["expectedHash"]
    print(f"integers {state['hash']}, {'as in the file' if same else 'NOT as in the file'}")
    for view in views[:VIEWS]:
        wanted = to_8bit(render_view(scene.dequantize(), view.camera)).astype(np.float64)
        error = np.mean((screenshot(browser, view.camera) - wanted) ** 2)
        print(f"{view.name}: screenshot {10 * math.log10(255**2 / error):.1f} dB")
    browser.load(file, WINDOW, "s.ready")
    frames, updates, gaussians = turn(browser, args.seconds)
    print(f"turning, {WINDOW} x {WINDOW} window: {frames:.1f} pictures per second, ", end="")
    print(f"{updates:.1f} sets of {gaussians:,} Gaussians per second")
    print(f"complaints of the browser: {len(browser.errors)}")


def screenshot(browser: Browser, camera: Camera) -> np.ndarray:
    """What the page shows of a camera, (height, width, 3)."""
    names = ("fx", "fy", "cx", "cy", "width", "height")
    view = {name: getattr(camera, name) for name in names}
    view["rotation"] = camera.rotation.ravel().tolist()
    view["translation"] = camera.translation.tolist()
    browser.value(f"clgs.setCamera({json.dumps(view)})")
    browser.wait("clgs.state().ready")
    return browser.screenshot(camera.width, camera.height).astype(np.float64)


def turn(browser: Browser, seconds: float) -> tuple[float, float, int]:
    """Pictures and sets per second while a mouse goes to and fro, and the Gaussians of a set."""

    def mouse(kind: str, x: float, **more: object) -> None:
        where = {"x": x, "y": WINDOW / 2, **more}
        browser.call("Input.dispatchMouseEvent", type=kind, **where)

    mouse("mousePressed", WINDOW / 2, button="left", buttons=1, clickCount=1)
    before, start = browser.value("clgs.state()"), time.perf_counter()
    while (spent := time.perf_counter() - start) < seconds:
        mouse("mouseMoved", WINDOW / 2 * (1 + 0.5 * math.sin(spent)), button="left", buttons=1)
        time.sleep(0.02)
    after = browser.value("clgs.state()")
    mouse("mouseReleased", WINDOW / 2, button="left", clickCount=1)
    counted = [(after[name] - before[name]) / spent for name in ("frames", "updates")]
    return counted[0], counted[1], after["gaussians"]


if __name__ == "__main__":
    main()
