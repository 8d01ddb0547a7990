"""The viewer through its web socket, as a browser speaks to it."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from clgs.export.clip.framing import frame_cameras, frame_scene
from clgs.synthetic.anchor_scene import anchor_scene
from clgs.viewer.live import LiveScene, eye_of
from clgs.viewer.server import Shown, open_server
from tests.codec.scenes import random_scene
from tests.export.clip.test_paths import ring
from tests.viewer.test_live import photo_view

viser = pytest.importorskip("viser", reason="needs clgs[view]")

PATIENCE = 120
"""Seconds after which an answer is taken for missing."""


@pytest.fixture
def server(open_device, rng):
    scene, _ = anchor_scene(800, 64, 2)
    live = LiveScene(open_device("cpu"), scene, np.ones(len(scene.anchors)))
    cameras = ring(6)
    framing = frame_cameras(cameras, frame_scene(random_scene(rng, 20), (80, 60)))
    photos = {"train": [photo_view(camera) for camera in cameras], "test": []}
    opened = open_server(
        Shown(live, photos, framing, (0.0, 0.0, 0.0), "anchors", 1_000_000), "127.0.0.1", 18_080
    )
    yield opened
    opened.stop()


def connect(server):
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    return connect(
        f"ws://127.0.0.1:{server.get_port()}",
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
        open_timeout=PATIENCE,
    )


def camera_message(eye):
    """What a browser sends when its camera has moved."""
    from viser._messages import ViewerCameraMessage

    forward = eye.camera(eye.size[1]).rotation[2]
    message = ViewerCameraMessage(
        tuple(eye.wxyz), tuple(eye.position), eye.fov, 0.01, 1000.0, eye.size[1], eye.size[0],
        tuple(eye.position + forward), (0.0, 0.0, 1.0),
    )  # fmt: skip
    return message


def pictures(socket, count):
    """The next pictures that the server sends, decoded."""
    import msgspec
    import zstandard

    found = []
    while len(found) < count:
        data = socket.recv(timeout=PATIENCE)
        packed = int.from_bytes(data[8:16], "little")
        text = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed])
        for message in msgspec.msgpack.decode(text)["messages"]:
            if message["type"] == "BackgroundImageMessage" and message["rgb_data"]:
                found.append(np.asarray(Image.open(io.BytesIO(message["rgb_data"]))))
    return found


def test_a_browser_gets_a_coarse_and_a_fine_picture_after_a_move(server):
    import msgspec

    eye = eye_of(ring(1)[0], (240, 160))
    with connect(server) as socket:
        socket.send(msgspec.msgpack.encode(camera_message(eye).as_serializable_dict()))
        heights = {picture.shape[0] for picture in pictures(socket, 2)}
    assert max(heights) == 160
    assert min(heights) <= 160
