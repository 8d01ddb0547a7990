"""`clgs view SCENE`: look at a scene in the browser, rendered live."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from clgs.cli.options.view import add_view_options, named_path, whole_number

if TYPE_CHECKING:
    from clgs.opencl.device import Device
    from clgs.scene.scene import QuantizedScene, SplatScene
    from clgs.viewer.server import Shown

PORT = 8080
HOST = "127.0.0.1"

DESCRIPTION = """\
Show a scene in the browser. This machine renders what the browser's camera sees: coarse while it
moves, fine when it rests. With --data the photos' cameras are shown, blue for training and orange
for held-out ones; a click on one goes there, and the photo can be laid over the render.

The address is open to this machine alone unless --host says otherwise."""


def register(parser: argparse.ArgumentParser) -> None:
    """Add the command and its options."""
    parser.description = DESCRIPTION
    parser.add_argument(
        "scene", type=named_path, metavar="SCENE", help="run folder, .clgs or 3DGS .ply file"
    )
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


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; exit code 130 then."""
    from clgs.cli.options.scene import read_drawable
    from clgs.cli.tell import tell
    from clgs.opencl.device import Device
    from clgs.viewer.server import close_server, load_viser, open_server

    load_viser()
    scene, size = read_drawable(args.scene)
    server = open_server(prepare(args, Device(args.device), scene, size), args.host, args.port)
    if server.get_port() != args.port:
        tell(f"clgs: port {args.port} is taken")
    print(f"http://{args.host}:{server.get_port()}  (Ctrl-C ends it)", flush=True)
    try:
        server.sleep_forever()
    finally:
        close_server(server)
    return 0


def prepare(
    args: argparse.Namespace,
    device: Device,
    scene: QuantizedScene | SplatScene,
    size: int | None,
) -> Shown:
    """All that the viewer shows of ``scene``, whose file has ``size`` bytes."""
    from clgs.cli.options.path import SIZE
    from clgs.cli.options.view import (
        load_views,
        name_known_data,
        over_background,
        selected_options,
    )
    from clgs.cli.progress import bar
    from clgs.export.clip.framing import frame_cameras, frame_scene
    from clgs.scene.scene import SplatScene, drawable
    from clgs.viewer.importance import chosen, scene_importance
    from clgs.viewer.live import LiveScene
    from clgs.viewer.server import Shown

    scene, options = over_background(args, scene), selected_options(args)
    photos, framing = {}, frame_scene(scene, SIZE)
    name_known_data(args)
    if args.data is not None:
        dataset = load_views(args, scene)
        photos = {"train": dataset.train, "test": dataset.test}
        framing = frame_cameras([view.camera for view in dataset.train], framing)
    cameras = [view.camera for view in photos.get("train", [])]
    is_splats = isinstance(scene, SplatScene)
    with bar(0 if is_splats else len(chosen(cameras)), "what matters most") as advance:
        importance = scene_importance(device, scene, cameras, options, advance)
    live = LiveScene(device, drawable(scene), importance, options)
    unit = "Gaussians" if is_splats else "anchors"
    return Shown(live, photos, framing, scene.settings.background, unit, size)
