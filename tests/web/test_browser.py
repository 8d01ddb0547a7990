"""The page in headless Chromium: no complaint, the file's integers, the picture of our renderer."""

import base64
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.codec.reader import SceneReader
from clgs.codec.scene_decoder import decode, describe
from clgs.codec.scene_encoder import encode
from clgs.codec.sections import BytesSource, read_table
from clgs.codec.splat_packing import pack, unpack
from clgs.data.origin import move_camera
from clgs.data.splats.gaussians import scene_of_packed
from clgs.data.splats.integer_splats import read_splats
from clgs.data.splats.ply import PlyTable, pack_ply
from clgs.errors import ClgsError
from clgs.exports import page
from clgs.lab.scenes import camera_of
from clgs.render.renderer import render_view
from clgs.scene.camera import PhotoRange
from clgs.scene.scene import IDENTITY
from clgs.train.quality.scores import to_8bit
from tests.data.splats.test_gaussians import columns_of
from tests.ops.cases.project import camera_at
from tests.ops.cases.splats import stored
from tests.web.browser import Browser, find_browser
from tests.web.scenes import SCALES, grey_wall, quantized_scene
from tests.web.slow_server import serve_slowly

SIZE = 96
LEAST_PSNR = 45.0
"""dB: half floats, and a pixel's last Gaussians before the renderer's stop; 30 were asked for."""

AT_ONCE = 4
"""Requests of a page that are under way at the same time; see web/page/stream.js."""

PROGRAM = find_browser()


def decoder_is_missing():
    try:
        page._decoder()
    except ClgsError:
        return True
    return False


pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="drives the browser through Linux's pipes"),
    pytest.mark.skipif(PROGRAM is None, reason="needs Chromium: Debian chromium-headless-shell"),
    pytest.mark.skipif(decoder_is_missing(), reason="clgs was built without the page's decoder"),
]


@pytest.fixture(scope="module")
def scene():
    quantized, camera = quantized_scene(3000, SIZE)
    return encode(quantized), quantized, camera


@pytest.fixture
def browser(tmp_path):
    browser = Browser(PROGRAM, tmp_path / "profile")
    yield browser
    browser.close()


def show(browser, camera):
    """The screenshot of the page at this camera."""
    view = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    view |= {
        "rotation": camera.rotation.ravel().tolist(),
        "translation": camera.translation.tolist(),
    }
    browser.value(f"clgs.setCamera({json.dumps(view)})")
    browser.wait("clgs.state().ready")
    return browser.screenshot(camera.width, camera.height).astype(np.float64)


def test_the_page_shows_what_the_renderer_shows(browser, scene, tmp_path):
    data, quantized, camera = scene
    file = tmp_path / "scene.html"
    file.write_bytes(page.scene_page(data, "scene"))
    state = browser.load(file, 2 * SIZE)
    assert state["failed"] is None
    assert state["hash"] == state["expectedHash"]
    assert "file intact" in browser.value("document.getElementById('status').textContent")
    wanted = to_8bit(render_view(quantized.dequantize(), camera)).astype(np.float64)
    found = show(browser, camera)
    assert wanted.std() > 20
    assert 10 * np.log10(255**2 / np.mean((found - wanted) ** 2)) >= LEAST_PSNR
    assert browser.errors == []


@pytest.mark.parametrize("case", ["enlarged", "reduced", "near", "far"])
def test_scenes_are_shown_at_other_sizes_as_we_draw_them(browser, tmp_path, case):
    """The bounds of the photos make this camera show the scene larger or smaller than they did."""
    quantized, camera = quantized_scene(3000, SIZE)
    focal = camera.fx * {"enlarged": 1 / 3, "reduced": 4.0}.get(case, 1.0)
    away = {"near": (9.0, 9.5), "far": (0.2, 0.3)}.get(case, (0.0, 99.0))
    photos = PhotoRange(focal, focal, 0.1, 0.2, -0.1, *away)
    changed = replace(quantized, settings=replace(quantized.settings, photos=photos))
    file = tmp_path / "scene.html"
    file.write_bytes(page.scene_page(encode(changed), "scene"))
    browser.load(file, 2 * SIZE)
    found = show(browser, camera)
    wanted, usual = (
        to_8bit(render_view(one.dequantize(), camera)).astype(np.float64)
        for one in (changed, quantized)
    )
    assert 10 * np.log10(255**2 / np.mean((found - wanted) ** 2)) >= LEAST_PSNR
    assert 10 * np.log10(255**2 / np.mean((found - usual) ** 2)) <= LEAST_PSNR - 5
    assert browser.errors == []


def test_a_file_given_to_the_viewer_is_shown(browser, scene, tmp_path):
    data, _, _ = scene
    file = tmp_path / "viewer.html"
    file.write_bytes(page.scene_page(b"", ""))
    browser.open(file, SIZE, SIZE)
    browser.wait("window.clgs && !document.getElementById('drop').hidden")
    give = "clgs.load(Uint8Array.from(atob('{}'), (c) => c.charCodeAt(0)), 'x.clgs')"
    browser.value(give.format(base64.b64encode(data[:-9]).decode()))
    assert "damaged" in browser.wait("clgs.state().failed")
    browser.value(give.format(base64.b64encode(data).decode()))
    state = browser.wait("clgs.state()", lambda s: s["ready"] or s["failed"])
    assert state["failed"] is None
    assert state["hash"] == state["expectedHash"]
    assert state["gaussians"] > 0
    assert browser.errors == []


def status(browser):
    return browser.value("document.getElementById('status').textContent")


@pytest.mark.parametrize("details", [False, True])
def test_a_scene_behind_an_address_is_shown_while_it_comes(browser, scene, details):
    _, quantized, camera = scene
    data = encode(quantized, chunk=64, layers=4, details=details)
    ends = [layer["end"] for layer in describe(data)["layers"]]
    view = to_8bit(render_view(quantized.dequantize(), camera)).astype(np.float64)
    with serve_slowly(page.scene_page(b"", "far", None, "s.clgs"), data) as server:
        browser.open(server.address + "page.html", 2 * SIZE, 2 * SIZE)
        errors = []
        for count, end in enumerate(ends, 1):
            server.let(end)
            browser.wait(f"window.clgs && clgs.state().layersReady === {count}")
            errors.append(np.mean((show(browser, camera) - view) ** 2))
            wanted = "file intact" if count == 4 else f"{count} of 4 layers, more comes"
            assert wanted in status(browser)
    assert 10 * np.log10(255**2 / errors[-1]) >= LEAST_PSNR
    assert errors == sorted(errors, reverse=True)
    assert server.asked == ["/page.html", "/s.clgs"]
    assert browser.errors == []


@pytest.fixture(scope="module")
def large():
    """A scene of about 700 kB in four layers, and the camera that sees all of it."""
    quantized, camera = quantized_scene(40_000, SIZE)
    return encode(quantized, chunk=64, layers=4, details=True), camera


def test_what_the_camera_sees_comes_first(browser, large):
    """If the server gives parts: what it does not see comes after all layers of what it sees."""
    data, camera = large
    along_x = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    inside = replace(camera, rotation=along_x, translation=np.array([0, 0, 0.4]))
    ends = [layer["end"] for layer in describe(data)["layers"]]
    with serve_slowly(page.scene_page(b"", ""), data, ranges=True) as server:
        server.let(ends[0])
        browser.load(
            server.address + "page.html?scene=s.clgs", SIZE, "s.layersReady === 1 && s.ready"
        )
        show(browser, inside)
        begun = len(server.parts)
        assert begun <= 4
        server.give(10**6)
        browser.wait("clgs.state().whole && clgs.state().ready")
        assert "file intact" in status(browser)
        found = show(browser, camera)
    wanted = to_8bit(render_view(decode(data).dequantize(), camera)).astype(np.float64)
    assert wanted.std() > 8
    assert 10 * np.log10(255**2 / np.mean((found - wanted) ** 2)) >= LEAST_PSNR
    assert sum(end - begin for begin, end in server.parts) == len(data) - ends[0]
    in_sight = [seen_along_x(data, *part) for part in server.parts[begun:] if part[1] <= ends[2]]
    assert all(one in ({True}, {False}) for one in in_sight)  # no request has both
    order = [one == {True} for one in in_sight]
    seen, others = sum(order), AT_ONCE - 1  # a request may be overtaken by those next to it
    assert order[0]
    assert others < seen < len(order)
    assert all(order[: seen - others])
    assert not any(order[seen + others :])
    assert browser.errors == []


def seen_along_x(data, begin, end):
    """Whether chunks in a part of the file are in sight from (-0.4, 0, 0), up to 60 degrees."""
    reader = SceneReader(BytesSource(data), read_table(BytesSource(data)))
    found = set()
    for chunk in reader.chunks():
        if begin <= reader.body + chunk.start and reader.body + chunk.end <= end:
            least, greatest = (
                np.divide(one, SCALES.position) for one in (chunk.least, chunk.greatest)
            )
            away, radius = (
                (least + greatest) / 2 + [0.4, 0, 0],
                np.linalg.norm(greatest - least) / 2,
            )
            found.add(bool(away[0] + radius >= 0.5 * (np.linalg.norm(away) - radius)))
    return found


@pytest.mark.parametrize("given", [0, 2])
def test_a_server_that_stops_giving_parts_leaves_a_coarser_scene(browser, large, given):
    data, _ = large
    ends = [layer["end"] for layer in describe(data)["layers"]]
    with serve_slowly(page.scene_page(b"", ""), data, ranges=True) as server:
        server.let(ends[0])
        browser.load(server.address + "page.html?scene=s.clgs", SIZE, "s.layersReady === 1")
        server.ranges = False
        server.let(0, cut=True)
        server.give(given)
        browser.wait("clgs.state().whole && clgs.state().ready")
        assert "4 layers, the rest is lost" in status(browser)


def test_a_download_that_ends_early_is_a_coarser_scene(browser, scene):
    data = encode(scene[1], chunk=64, layers=4)
    ends = [layer["end"] for layer in describe(data)["layers"]]
    with serve_slowly(page.scene_page(b"", ""), data) as server:
        server.let(ends[1] + 50, cut=True)
        browser.load(server.address + "page.html?scene=s.clgs", SIZE, "s.whole && s.ready")
        assert "2 of 4 layers, the rest is lost" in status(browser)
        server.let(ends[0] - 50, cut=True)
        browser.load(server.address + "page.html?scene=s.clgs", SIZE, "s.failed")
        state = browser.load(server.address + "page.html?scene=gone.clgs", SIZE, "s.failed")
        assert "the server says 404" in state["failed"]


def test_a_download_that_ends_in_the_details_is_the_scene_without_them(browser, scene):
    data = encode(scene[1], chunk=64, layers=3, details=True)
    with serve_slowly(page.scene_page(b"", ""), data) as server:
        server.let(len(data) - 1, cut=True)
        browser.load(server.address + "page.html?scene=s.clgs", SIZE, "s.whole && s.ready")
        assert "2 of 3 layers, the rest is lost" in status(browser)


def test_a_file_without_layers_comes_from_an_address_too(browser, scene):
    with serve_slowly(page.scene_page(b"", ""), scene[0]) as server:
        server.let(len(scene[0]))
        browser.load(server.address + "page.html?scene=s.clgs", SIZE, "s.ready")
        assert "file intact" in status(browser)
    assert browser.errors == []


@pytest.fixture
def page_of_scene(browser, scene, tmp_path):
    """The browser with the scene's page, 400 x 400 pixels, and a screen that feels fingers."""
    file = tmp_path / "scene.html"
    file.write_bytes(page.scene_page(scene[0], "scene"))
    browser.open(file, 400, 400)
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    browser.wait("window.clgs && clgs.state().ready")
    return browser


def touch(browser, *moments):
    """Fingers on the screen at each moment: their places, in the same order; then none."""
    for number, places in enumerate(moments):
        points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
        kind = "touchMove" if number else "touchStart"
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


def test_one_finger_turns_and_two_pinch(page_of_scene):
    browser, before = page_of_scene, page_of_scene.value("clgs.state()")
    touch(browser, [(200, 200)], [(220, 200)], [(240, 190)])
    # three radians per width of the window, once the motion has settled
    turned = browser.wait("clgs.state()", lambda s: abs(s["yaw"] - before["yaw"] + 0.3) < 0.01)
    assert turned["pitch"] == pytest.approx(before["pitch"] - 3 * 10 / 400, abs=0.01)
    assert turned["distance"] == pytest.approx(before["distance"], rel=1e-3)
    touch(browser, [(150, 200), (250, 200)], [(125, 200), (275, 200)], [(100, 200), (300, 200)])
    near = turned["distance"] / 2
    pinched = browser.wait("clgs.state()", lambda s: abs(s["distance"] / near - 1) < 0.01)
    assert pinched["yaw"] == pytest.approx(turned["yaw"], abs=0.01)
    assert browser.errors == []


def test_the_mouse_turns_and_zooms_and_keys_walk(page_of_scene):
    browser, before = page_of_scene, page_of_scene.value("clgs.state()")

    def mouse(kind, x, y, **more):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    mouse("mousePressed", 100, 100, button="left", buttons=1, clickCount=1)
    mouse("mouseMoved", 140, 100, button="left", buttons=1)
    mouse("mouseReleased", 140, 100, button="left", clickCount=1)
    browser.wait("clgs.state()", lambda s: abs(s["yaw"] - before["yaw"] + 0.3) < 0.01)
    mouse("mouseWheel", 200, 200, deltaX=0, deltaY=-100)
    near = before["distance"] * np.exp(-0.12)
    browser.wait("clgs.state()", lambda s: abs(s["distance"] / near - 1) < 0.01)
    browser.call("Input.dispatchKeyEvent", type="keyDown", code="KeyW", key="w")
    browser.wait(
        "clgs.state()", lambda s: np.linalg.norm(np.subtract(s["target"], before["target"])) > 0.05
    )
    browser.call("Input.dispatchKeyEvent", type="keyUp", code="KeyW", key="w")
    assert browser.errors == []


def test_colors_are_shown_as_they_are(browser, tmp_path):
    file = tmp_path / "wall.html"
    file.write_bytes(page.scene_page(pack(grey_wall()), "wall"))
    browser.load(file, SIZE, "s.ready")
    # 0.5 - 0.2821 = 0.2179; twice alpha 0.99 leaves 1/10,000 of the black behind
    assert (show(browser, camera_of(SIZE, SIZE))[40:56, 40:56] == 56).all()
    assert browser.errors == []


@pytest.mark.parametrize(
    ("times", "place", "marked"),
    [(1.0, (0, 0, 0), True), (0.01, (0, 0, 0), False), (1.0, (5e5, 5.4e6, 1e2), False)],
)
def test_splats_of_other_programs_are_shown_as_we_draw_them(
    browser, tmp_path, rng, times, place, marked
):
    """Antialiased ones, small scenes, and scenes far from the origin, with their cameras."""
    gaussians = stored(rng, 600)
    gaussians.log_scale[:] -= 1.0
    columns = columns_of(gaussians)
    for i, (name, middle) in enumerate(zip("xyz", place, strict=True)):
        columns[name] = columns[name].astype(np.float64) * times + middle
        columns[f"scale_{i}"] = columns[f"scale_{i}"] + np.float32(np.log(times))
    path, file = tmp_path / "s.ply", tmp_path / "s.html"
    path.write_bytes(pack_ply(PlyTable(columns, ["antialiased 1"] * marked)))
    assert cli.main(["export", str(path), "-o", str(file)]) == 0
    data = pack(read_splats(path, {})[0])
    scene = scene_of_packed(unpack(data), path)
    near = camera_at(80.0, SIZE, SIZE)
    camera = replace(near, translation=times * near.translation - near.rotation @ np.array(place))
    shown = render_view(scene, move_camera(camera, IDENTITY, scene.transform))
    browser.load(file, SIZE, "s.ready")
    found, wanted = show(browser, camera), to_8bit(shown).astype(np.float64)
    assert wanted.std() > 8
    assert 10 * np.log10(255**2 / np.mean((found - wanted) ** 2)) >= 40
    assert browser.errors == []
