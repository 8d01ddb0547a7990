"""The viewer's side of the browser: viser shows pictures, photos' cameras and controls.

Only who may speaks to the viewer. Its address ends in a token, which other pages and other users of
this machine do not know. The header Host must name this machine: a page whose name is made to lead
here (DNS rebinding) gives its own. The header Origin, which browsers add, must be that of the
viewer's own page.
"""

from __future__ import annotations

import io
import secrets
import socket
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from clgs.data.view import View
from clgs.errors import ClgsError
from clgs.exports.framing import Framing
from clgs.viewer.live import (
    RENDER,
    SHOWN,
    Eye,
    Follower,
    LiveScene,
    compare,
    eye_of,
    names_of,
    stands_at,
)

REFUSED = "open the address that `clgs view` has printed\n"


def may_enter(host: str, token: str, path: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a request is answered.

    Args:
        host: the name or the address that the server listens at.
        token: the first part of every path.
        path: of the request.
        hosts: its headers Host.
        origins: its headers Origin; programs that are no browsers send none.
    """
    first = path.partition("?")[0].split("/")[1:2]
    if not first or not secrets.compare_digest(ascii(first[0]), ascii(token)):
        return False
    try:
        (netloc,) = hosts
        name = (urlsplit(f"//{netloc}").hostname or "").rstrip(".")
        own_pages = all(urlsplit(origin).netloc.lower() == netloc.lower() for origin in origins)
    except ValueError:
        return False
    return own_pages and _is_here(name, host)


def _is_here(name: str, host: str) -> bool:
    """Whether a name of a Host header is this machine's, or an address: no page is named by one."""
    own = socket.gethostname().lower()
    if name in ("localhost", host.lower(), own, f"{own}.local", own.partition(".")[0]):
        return bool(name)
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def guarded(host: str, token: str) -> Iterator[None]:
    """Servers of web sockets that are opened in the block answer only whom :func:`may_enter` lets.

    viser has no hook of its own for this.

    Raises:
        ClgsError: viser has not opened its server by the function that is guarded.
    """
    from websockets.asyncio import server as sockets

    plain, used = sockets.serve, False

    def serve(*args: Any, process_request: Callable[[Any, Any], Any], **options: Any) -> Any:
        nonlocal used
        used = True

        def answer(connection: Any, request: Any) -> Any:
            get = request.headers.get_all
            if not may_enter(host, token, request.path, get("Host"), get("Origin")):
                return connection.respond(403, REFUSED)
            inside = request.path.partition("?")[0].split("/", 2)[2:]
            return process_request(connection, replace(request, path=f"/{''.join(inside)}"))

        return plain(*args, process_request=answer, **options)

    sockets.serve = serve  # type: ignore[assignment,misc]  # a function for a class
    try:
        yield
    finally:
        sockets.serve = plain  # type: ignore[misc]  # the class again
    if not used:
        raise ClgsError("this version of viser opens its server in an unknown way; install 1.1")


FRUSTUM_DEPTH = 0.05
"""Size of a photo's camera as a share of the ring's radius."""

LINE = 1.5
"""Pixels."""

BOX_COLOR = (240, 200, 40)

COLORS = {"train": (40, 90, 220), "test": (230, 120, 20)}
START = 1.25
"""The distance of the first place from the centre, in distances of the photos' cameras."""

NO_PHOTO = "(free)"
STILL_ROWS = 1080
"""The most rows of a picture at rest."""


@dataclass(frozen=True)
class Shown:
    """A scene, photos by split, and where to begin.

    background: red, green and blue in [0, 1]; unit: what the scene is made of, "anchors" or
    "Gaussians"; nbytes: of its file, if there is one; box: two opposite corners (2, 3) of a box
    whose edges are shown, in scene units.
    """

    live: LiveScene
    photos: dict[str, list[View]]
    framing: Framing
    background: tuple[float, float, float]
    unit: str
    nbytes: int | None
    box: npt.NDArray[np.float64] | None = None


def load_viser() -> Any:
    """The module; ClgsError if it is missing."""
    try:
        import viser
    except ImportError as error:
        raise ClgsError(f'the viewer needs viser ({error}): pip install "clgs[view]"') from error
    return viser


def open_server(shown: Shown, host: str, port: int, token: str) -> Any:
    """A viser server that shows a scene until :func:`close_server`; ``get_port()`` is its port.

    Its page is at http://HOST:PORT/TOKEN/, see :mod:`clgs.viewer.server`.

    Raises:
        ClgsError: viser is missing, or the address or the port cannot be opened.
    """
    viser = load_viser()
    try:  # viser would wait for ever for an address that is not this machine's
        family = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0][0]
        socket.create_server((host, 0), family=family).close()
    except OSError as error:
        raise ClgsError(
            f"host {host} cannot be used ({error}); give another --host, such as 0.0.0.0"
        ) from error
    # a picture that was drawn while its browser went away
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    try:
        with guarded(host, token), redirect_stdout(io.StringIO()):  # it prints an address
            server = viser.ViserServer(host=host, port=port, label="clgs", verbose=False)
    except OSError as error:
        raise ClgsError(f"port {port} cannot be opened ({error}); give another --port") from error
    if shown.box is not None:
        edges, width = box_edges(shown.box), {"thickness": LINE, "thickness_units": "screen"}
        server.scene.add_line_segments("/box", edges, BOX_COLOR, **width)
    framing = shown.framing
    server.scene.set_up_direction(tuple(framing.up))
    start = framing.place(framing.arc[0] if framing.closed else sum(framing.arc) / 2)
    server.initial_camera.position = tuple(framing.centre + START * (start - framing.centre))
    server.initial_camera.look_at = tuple(framing.centre)
    server.initial_camera.fov = float(np.radians(framing.fov))
    windows: dict[int, _Window] = {}

    def enter(client: Any) -> None:
        windows[client.client_id] = _Window(shown, client)

    def leave(client: Any) -> None:
        window = windows.pop(client.client_id, None)
        if window is not None:
            window.follower.stop()

    server.on_client_connect(enter)
    server.on_client_disconnect(leave)
    return server


def box_edges(box: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """The ends of the 12 edges, (12, 2, 3), of the box between two opposite corners (2, 3)."""
    bits = np.indices((2, 2, 2)).reshape(3, 8).T
    corners = np.where(bits, box[1], box[0])
    pairs = [(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]
    return np.asarray(corners[pairs], np.float32)


def close_server(server: Any) -> None:
    """End the server that :func:`open_server` made."""
    with redirect_stdout(io.StringIO()):  # it says so
        server.stop()


class _Window:
    """One browser: its controls, its camera, and the thread that draws for it."""

    def __init__(self, shown: Shown, client: Any) -> None:
        self._shown, self._client = shown, client
        views = [view for some in shown.photos.values() for view in some]
        self._views = dict(zip(names_of(views), views, strict=True))
        self.follower = Follower(self._draw)
        self._add_controls()
        self._add_photos()
        client.camera.on_update(lambda _: self.follower.move())
        self.follower.move()

    def _add_controls(self) -> None:
        gui = self._client.gui
        self._size = gui.add_slider("size, %", min=1, max=100, step=1, initial_value=100)
        self._text = gui.add_markdown(self._size_text())
        self._size.on_update(lambda _: self._resize())
        if not self._views:
            return
        names = [NO_PHOTO, *self._views]
        self._photo = gui.add_dropdown("photo", names, initial_value=NO_PHOTO)
        self._what = gui.add_dropdown("show", SHOWN, initial_value=RENDER)
        self._cameras = gui.add_checkbox("cameras", True)
        self._photo.on_update(lambda _: self._go_to_photo())
        self._what.on_update(lambda _: self.follower.move())
        self._cameras.on_update(lambda _: self._show_cameras())

    def _add_photos(self) -> None:
        """The photos' cameras; a click on one goes there."""
        scale = FRUSTUM_DEPTH * self._shown.framing.ring
        names = iter(self._views)
        self._frusta: list[Any] = []
        for split, views in self._shown.photos.items():
            for view in views:
                name, camera = next(names), view.camera
                eye = eye_of(camera, (camera.width, camera.height))
                frustum = self._client.scene.add_camera_frustum(
                    f"/photos/{split}/{len(self._frusta)}",
                    fov=eye.fov,
                    aspect=camera.width / camera.height,
                    scale=scale,
                    thickness=LINE,
                    thickness_units="screen",
                    color=COLORS.get(split, COLORS["train"]),
                    wxyz=eye.wxyz,
                    position=eye.position,
                )
                frustum.on_click(lambda _, name=name: self._choose(name))
                self._frusta.append(frustum)

    def _choose(self, name: str) -> None:
        self._photo.value = name
        self._go_to_photo()

    def _go_to_photo(self) -> None:
        view = self._views.get(self._photo.value)
        if view is None:
            return self.follower.move()
        camera = self._client.camera
        eye = eye_of(view.camera, self._window_size())
        down, forward = view.camera.rotation[1], view.camera.rotation[2]
        with self._client.atomic():
            camera.position = eye.position
            camera.up_direction = -down
            camera.look_at = eye.position + forward * self._shown.framing.ring
            camera.fov = eye.fov
        return self.follower.move()

    def _show_cameras(self) -> None:
        for frustum in self._frusta:
            frustum.visible = self._cameras.value

    def _resize(self) -> None:
        self._text.content = self._size_text()
        self.follower.move()

    def _size_text(self) -> str:
        share = self._size.value / 100
        text = f"{self._shown.live.kept(share):,} {self._shown.unit}"
        if self._shown.nbytes is not None:
            text += f", about {share * self._shown.nbytes / 1e6:.2f} MB"
        return text

    def _window_size(self) -> tuple[int, int]:
        camera = self._client.camera
        return max(1, camera.image_width), max(1, camera.image_height)

    def _draw(self, moving: bool) -> None:
        """Send a picture of what the browser's camera sees; the follower's thread calls this.

        The chosen photo is laid over it if the camera stands where the photo was taken.
        """
        place, live = self._client.camera, self._shown.live
        eye = Eye(np.array(place.wxyz), np.array(place.position), place.fov, self._window_size())
        view = self._views.get(self._photo.value) if self._views else None
        try:
            camera = eye.camera(live.moving_rows(eye) if moving else STILL_ROWS)
            picture = live.picture(camera, self._size.value / 100)
            if view is not None and stands_at(camera, view):
                background = self._shown.background
                picture = compare(picture, camera, view, background, self._what.value)
        except ClgsError as error:
            self._client.add_notification("clgs", str(error), auto_close_seconds=10.0)
            return
        self._client.scene.set_background_image(picture, jpeg_quality=75 if moving else 92)
        self._client.flush()
