"""`clgs view SCENE`: look at a scene in the browser, rendered live."""

from __future__ import annotations

import argparse
import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.cli.options import (
    AS_TRAINED,
    add_box,
    add_masks,
    add_view_options,
    view_options,
    whole_number,
)
from clgs.workflow.options import SIZE, ViewOptions

if TYPE_CHECKING:
    from clgs.viewer.server import Shown
    from clgs.workflow.events import OnEvent

PORT = 8080
HOST = "127.0.0.1"

DESCRIPTION = """\
Show a scene in the browser. This machine renders what the browser's camera sees: coarse while it
moves, fine when it rests. With --data the photos' cameras are shown, blue for training and orange
for held-out ones; a click on one goes there, and the photo can be laid over the render.

The address is open to this machine alone unless --host says otherwise, and to those alone who have
all of it: it ends in a token that is new each time. Pages of other sites are refused."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    parser.add_argument(
        "--port",
        type=whole_number(65535),
        default=PORT,
        metavar="N",
        help=f"(default: {PORT}, or the next that is free)",
    )
    parser.add_argument(
        "--host",
        default=HOST,
        metavar="ADDRESS",
        help=f"0.0.0.0: also for other machines (default: {HOST})",
    )
    add_view_options(parser, split=False)
    add_masks(parser, AS_TRAINED)
    add_box(parser, "show the edges of this box, such as that of `clgs crop`")


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; exit code 130 then."""
    from clgs.cli.display import Display
    from clgs.cli.tell import tell
    from clgs.viewer.server import close_server, load_viser, open_server

    load_viser()
    with Display() as display:
        shown = scene_to_show(args.scene, view_options(vars(args)), args.box, display)
    token = secrets.token_urlsafe(12)
    server = open_server(shown, args.host, args.port, token)
    if server.get_port() != args.port:
        tell(f"clgs: port {args.port} is taken")
    named = {"0.0.0.0": HOST, "::": HOST}.get(args.host, args.host)
    if named != args.host:
        tell(f"clgs: other machines name this one in place of {HOST}")
    named = f"[{named}]" if ":" in named else named
    print(f"http://{named}:{server.get_port()}/{token}/  (Ctrl-C ends it)", flush=True)
    try:
        server.sleep_forever()
    finally:
        close_server(server)
    return 0


def scene_to_show(
    path: Path, views: ViewOptions, ends: list[float] | None, on_event: OnEvent
) -> Shown:
    """Read a scene, and all that the viewer shows of it; ``ends`` of a box as --box gives them."""
    import numpy as np

    from clgs.errors import UsageError
    from clgs.exports.framing import frame_cameras, frame_scene
    from clgs.opencl.device import Device
    from clgs.scene.region import Box
    from clgs.scene.scene import SplatScene, drawable
    from clgs.viewer.live import LiveScene, chosen, scene_importance
    from clgs.viewer.server import Shown
    from clgs.workflow.events import counter
    from clgs.workflow.scenes import read_drawable
    from clgs.workflow.views import (
        check_photo_options,
        drawing_options,
        known_data,
        load_views,
        over_background,
    )

    corners = np.array(ends or [0, 0, 0, 1, 1, 1], np.float64).reshape(2, 3)
    Box(tuple(corners[0]), tuple(corners[1]))
    if not np.isfinite(corners).all():
        raise UsageError("--box: a box without an end cannot be shown; give finite numbers")
    scene, size = read_drawable(path)
    scene = over_background(scene, views.background)
    options = drawing_options(path, views, scene)
    views = replace(views, data=views.data or known_data(path))
    check_photo_options(views)
    photos, framing = {}, frame_scene(scene, SIZE)
    if views.data is not None:
        dataset = load_views(path, scene, views, on_event)
        photos = {"train": dataset.train, "test": dataset.test}
        framing = frame_cameras([view.camera for view in dataset.train], framing)
    cameras = [view.camera for view in photos.get("train", [])]
    is_splats = isinstance(scene, SplatScene)
    device = Device(views.device)
    advance = counter("importance", 0 if is_splats else len(chosen(cameras)), on_event)
    importance = scene_importance(device, scene, cameras, options, advance)
    live = LiveScene(device, drawable(scene), importance, options)
    unit = "Gaussians" if is_splats else "anchors"
    box = scene.transform.to_scene(corners) if ends else None
    return Shown(live, photos, framing, scene.settings.background, unit, size, box)
