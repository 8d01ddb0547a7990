"""The viewer through its web socket, as a browser speaks to it."""

import io
import socket
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from clgs.errors import ClgsError
from clgs.exports.framing import frame_cameras, frame_scene
from clgs.lab.scenes import anchor_scene
from clgs.viewer.live import LiveScene, eye_of
from clgs.viewer.server import Shown, box_edges, close_server, may_enter, open_server
from tests.codec.scenes import random_scene
from tests.exports.test_camera_path import ring
from tests.viewer.test_live import photo_view

viser = pytest.importorskip("viser", reason="needs clgs[view]")

TOKEN = "secret"

BOX = np.array([[-1.0, -2.0, 0.5], [1.0, 3.0, 1.5]])

PATIENCE = 120
"""Seconds after which an answer is taken for missing."""


@pytest.fixture
def server(open_device, rng):
    scene, _ = anchor_scene(800, 64, 2)
    live = LiveScene(open_device("cpu"), scene, np.ones(len(scene.anchors)))
    cameras = ring(6)
    framing = frame_cameras(cameras, frame_scene(random_scene(rng, 20), (80, 60)))
    photos = {"train": [photo_view(camera) for camera in cameras], "test": []}
    shown = Shown(live, photos, framing, (0.0, 0.0, 0.0), "anchors", 1_000_000, BOX)
    opened = open_server(shown, "127.0.0.1", 18_080, TOKEN)
    yield opened
    close_server(opened)


def connect(server, path=f"/{TOKEN}", **headers):
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    return connect(
        f"ws://127.0.0.1:{server.get_port()}{path}",
        additional_headers=headers,
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


def messages(socket):
    """What the server sends, as records, without end."""
    import msgspec
    import zstandard

    while True:
        data = socket.recv(timeout=PATIENCE)
        packed = int.from_bytes(data[8:16], "little")
        text = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed])
        yield from msgspec.msgpack.decode(text)["messages"]


def next_picture(received):
    """The next picture (H, W, 3) among messages."""
    for message in received:
        if message["type"] == "BackgroundImageMessage" and message["rgb_data"]:
            return np.asarray(Image.open(io.BytesIO(message["rgb_data"])))
    raise AssertionError("no more messages")


def send(socket, message):
    import msgspec

    socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))


def test_a_browser_gets_a_coarse_and_a_fine_picture_after_a_move(server):
    eye = eye_of(ring(1)[0], (240, 160))
    with connect(server) as socket:
        send(socket, camera_message(eye))
        received = messages(socket)
        heights = {next_picture(received).shape[0] for _ in range(2)}
    assert max(heights) == 160


@pytest.mark.parametrize("fault", [{"position": (np.nan, 0.0, 0.0)}, {"wxyz": (0.0,) * 4}])
def test_a_camera_that_is_none_does_not_end_the_pictures(server, fault):
    eye = eye_of(ring(1)[0], (240, 160))
    with connect(server) as socket:
        send(socket, replace(camera_message(eye), **fault))
        received = messages(socket)
        assert any(message["type"] == "NotificationShowMessage" for message in received)
        send(socket, camera_message(eye))
        assert next_picture(received).shape[2] == 3


def test_the_edges_of_a_box_are_shown(server):
    with connect(server) as socket:
        send(socket, camera_message(eye_of(ring(1)[0], (240, 160))))
        names = (message.get("name") for message in messages(socket))
        assert "/box" in names
    edges = box_edges(BOX)
    assert len({tuple(map(tuple, edge)) for edge in edges.tolist()}) == 12
    lengths = np.abs(edges[:, 1] - edges[:, 0])
    assert sorted(lengths.sum(axis=1).tolist()) == [1.0] * 4 + [2.0] * 4 + [5.0] * 4
    assert ((lengths > 0).sum(axis=1) == 1).all()
    assert ((edges == BOX[0]) | (edges == BOX[1])).all()


def test_a_photo_is_gone_to_and_shown(server):
    from viser._messages import GuiUpdateMessage

    there = ring(6)[3]
    controls, moved = {}, {}
    with connect(server) as socket:
        send(socket, camera_message(eye_of(ring(1)[0], (240, 160))))
        received = messages(socket)
        while {"photo", "show"} - controls.keys():
            message = next(received)
            if message["type"] == "GuiDropdownMessage":
                controls[message["props"]["label"]] = message
        assert [*controls["photo"]["props"]["options"][1:3]] == ["a", "a (2)"]
        for label, value in (("show", "photo"), ("photo", "a (4)")):
            send(socket, GuiUpdateMessage(controls[label]["uuid"], {"value": value}))
        while {"SetCameraPositionMessage", "SetCameraLookAtMessage"} - moved.keys():
            message = next(received)
            moved[message["type"]] = message
        place = moved["SetCameraPositionMessage"]["position"]
        np.testing.assert_allclose(place, there.centre, atol=1e-6)
        send(socket, camera_message(eye_of(there, (240, 160))))
        picture = next_picture(received)
        while picture.shape[0] < 160 or abs(int(picture[120, 120, 1]) - 200) > 8:
            picture = next_picture(received)
    assert (np.abs(picture[100:150, 20:220].astype(int) - 200) < 12).all()
    assert (np.abs(picture[10:60, 20:220].astype(int) - 100) < 12).all()


@pytest.mark.filterwarnings("ignore:Queued a")
def test_the_web_socket_takes_its_own_page_alone(server):
    from websockets.exceptions import InvalidStatus

    own = f"http://127.0.0.1:{server.get_port()}"
    with connect(server, Origin=own) as socket:
        assert socket.subprotocol
    for path, origin in (("", own), ("/wrong", own), (f"/{TOKEN}", "http://evil.example")):
        with pytest.raises(InvalidStatus, match="403"):
            connect(server, path, Origin=origin)


@pytest.mark.parametrize(
    ("path", "host", "origin", "enters"),
    [
        ("/secret/", "127.0.0.1:8080", None, True),
        ("/secret", "localhost:8080", "http://localhost:8080", True),
        ("/secret/?websocket=x", "[::1]:8080", "http://[::1]:8080", True),
        ("/secret/", "192.168.1.2:9", "http://192.168.1.2:9", True),  # by --host, or a tunnel
        ("/secret/", socket.gethostname(), None, True),
        ("/", "127.0.0.1:8080", None, False),
        ("/secrets/", "127.0.0.1:8080", None, False),
        ("/x/secret/", "127.0.0.1:8080", None, False),
        ("/secret/", "evil.example:8080", "http://evil.example:8080", False),
        ("/secret/", "127.0.0.1.evil.example", None, False),
        ("/secret/", "127.0.0.1:8080", "http://evil.example", False),
        ("/secret/", "127.0.0.1:8080", "http://127.0.0.1:8081", False),
        ("/secret/", "127.0.0.1:8080", "null", False),
        ("/secret/", "user@127.0.0.1:8080", "http://evil.example", False),
        ("/secret/", "[", None, False),
        ("/\udcc3\udca9/", "127.0.0.1:8080", None, False),
        ("/secret/", "", None, False),
    ],
)
def test_whom_the_viewer_answers(path, host, origin, enters):
    origins = [] if origin is None else [origin]
    assert may_enter("127.0.0.1", TOKEN, path, [host], origins) == enters
    assert not may_enter("127.0.0.1", TOKEN, path, [host, host], origins)


@pytest.mark.parametrize("host", ["192.0.2.1", "2001:db8::1", "no.such.name.invalid"])
def test_an_address_of_another_machine_is_refused_at_once(host):
    said = rf"^host {host} cannot be used .*; give another --host, such as 0\.0\.0\.0$"
    with pytest.raises(ClgsError, match=said):
        open_server(None, host, 0, "token")
