"""The least memory budget that views need, known before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from clgs.errors import BudgetError
from clgs.opencl.device import Device
from clgs.options import RenderOptions
from clgs.render.frame import Drawable, upload_view
from clgs.render.picture import draw
from clgs.scene.camera import Camera
from clgs.scene.scene import RenderSettings

MIB = 2**20


def check_budget(
    device: Device,
    scene: Drawable,
    views: Iterable[tuple[str, Camera]],
    settings: RenderSettings,
    options: RenderOptions,
) -> None:
    """Refuse an ``options.max_memory`` that is too small for one of ``views``, (name, camera).

    Nothing is drawn; a view takes the time of all stages before that.

    Raises:
        BudgetError: names the view that needs most, and the least budget for all of them.
    """
    if options.max_memory is None:
        return
    needs = {name: _needed(device, scene, one, settings, options) for name, one in views}
    worst = max(needs, key=needs.__getitem__, default="")
    if needs and needs[worst] > options.max_memory:
        least = -(-needs[worst] // MIB)
        raise BudgetError(
            f"view {worst}: a row of tiles needs {needs[worst] / MIB:.1f} MiB; {least} MiB are "
            f"enough for all {len(needs)} views: give --max-memory {least}, a smaller image or "
            "fewer Gaussians",
            needs[worst],
        )


def _needed(
    device: Device,
    scene: Drawable,
    camera: Camera,
    settings: RenderSettings,
    options: RenderOptions,
) -> int:
    """Bytes that the largest row of tiles of a view takes."""
    view = upload_view(device, camera.reduced(options.accuracy.downscale), settings)
    try:
        draw(device, scene, view, replace(options, max_memory=0))
    except BudgetError as error:
        return error.needed
    return 0
