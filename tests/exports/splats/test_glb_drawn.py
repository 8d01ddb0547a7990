"""An exported GLB, drawn by three.js in headless Chromium, is the picture of our renderer."""

import functools
import http.server
import json
import os
import shutil
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgs.exports.glb import encode_glb
from clgs.render.renderer import Renderer
from clgs.scene.camera import Camera
from clgs.scene.scene import SplatScene
from clgs.train.quality.scores import psnr_8bit, to_8bit
from tests.exports.splats.cases import gaussians
from tests.exports.splats.test_other_programs import installed
from tests.ops.cases.project import camera_at
from tests.web.browser import Browser, find_browser

TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
NEAR, FAR = 0.1, 100.0

LEAST_PSNR = 25.0
"""dB: three.js ends every Gaussian at two standard deviations, and packs harmonics into bytes."""

PROGRAM = find_browser()

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="drives the browser through Linux's pipes"),
    pytest.mark.skipif(PROGRAM is None, reason="needs Chromium: Debian chromium-headless-shell"),
]


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves files without a word."""

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


@pytest.fixture
def page(tmp_path):
    """The address of the page, in a folder with three.js; a test puts scene.glb there, too."""
    three = installed("node_modules/three/examples/jsm/objects/GaussianSplat.js")
    os.symlink(three.parents[4], tmp_path / "node_modules")
    shutil.copy(Path(__file__).with_name("draw_glb.html"), tmp_path)
    handler = functools.partial(Quiet, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/draw_glb.html"
        server.shutdown()


def gl_camera(camera: Camera) -> dict[str, object]:
    """The camera as the page takes it, in the axes of glTF."""
    projection = np.zeros((4, 4))
    projection[0] = [2 * camera.fx / camera.width, 0, 1 - 2 * camera.cx / camera.width, 0]
    projection[1] = [0, 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1, 0]
    projection[2, 2:] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    projection[3, 2] = -1
    world = np.eye(4)
    world[:3, :3] = TURN @ camera.rotation.T @ np.diag([1.0, -1.0, -1.0])
    world[:3, 3] = TURN @ camera.centre
    matrices = {"projection": projection.T.ravel().tolist(), "world": world.T.ravel().tolist()}
    return {**matrices, "width": camera.width, "height": camera.height}


def test_three_draws_what_the_renderer_draws(page, tmp_path, open_device):
    camera = camera_at()
    scene = gaussians(count=3000)
    scene = replace(scene, mean=scene.mean / 3, log_scale=np.minimum(scene.log_scale - 1, -2.5))
    (tmp_path / "scene.glb").write_bytes(encode_glb(scene, turn=TURN).data)
    browser = Browser(PROGRAM, tmp_path / "profile")
    try:
        size = {"width": camera.width, "height": camera.height}
        browser.call(
            "Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=1, mobile=False
        )
        browser.call("Page.navigate", url=page)
        browser.wait("window.result", lambda result: result == "loaded")
        browser.value(f"start({json.dumps(gl_camera(camera))})")
        assert browser.wait("window.result", lambda result: result != "drawing") == "drawn"
        found = browser.screenshot(camera.width, camera.height)
    finally:
        browser.close()
    wanted = to_8bit(Renderer(open_device("cpu"), SplatScene(scene)).render(camera))
    assert wanted.std() > 20
    assert psnr_8bit(found, wanted) >= LEAST_PSNR
    assert psnr_8bit(found[:, ::-1], wanted) < LEAST_PSNR - 10
