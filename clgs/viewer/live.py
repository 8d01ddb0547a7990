"""Pictures of a scene for a camera that somebody moves: coarse while it moves, then fine.

A photo can be laid over the render of the camera that took it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from clgs.data.masks import USED
from clgs.data.view import Color, View
from clgs.errors import DataError
from clgs.exports.camera_path import pinhole
from clgs.exports.pictures import Picture, error_map
from clgs.opencl.device import Device
from clgs.options import DEFAULT, RenderOptions
from clgs.render.frame import upload_scene
from clgs.render.renderer import Renderer
from clgs.scene.anchors import take
from clgs.scene.camera import Camera
from clgs.scene.gaussians import HostGaussians
from clgs.scene.scene import QuantizedScene, Scene, SplatScene
from clgs.train.quality.importance import importance_without_views, sensitivity
from clgs.train.quality.scores import to_8bit

RENDER, PHOTO, HALVES, ERROR = "render", "photo", "half photo, half render", "error"
SHOWN = (RENDER, PHOTO, HALVES, ERROR)
"""The pictures that can be shown at the camera of a photo."""

NEAR = 1e-3
"""A camera stands at a photo's if it is no further away, in scene units and radians."""


def stands_at(camera: Camera, view: View) -> bool:
    """Whether a camera has the place and the direction of a photo's."""
    there = view.camera
    far = float(np.linalg.norm(camera.centre - there.centre))
    cosine = (np.trace(camera.rotation @ there.rotation.T) - 1) / 2
    return bool(
        far <= NEAR * max(1.0, float(np.linalg.norm(there.centre))) and cosine > 1 - NEAR**2
    )


def compare(render: Picture, camera: Camera, view: View, background: Color, shown: str) -> Picture:
    """The picture that ``shown``, one of SHOWN, names: render, photo or both, (H, W, 3) uint8.

    ``camera`` stands where the photo was taken; what it sees, ``render`` (H, W, 3) uint8, surrounds
    the photo. ``background`` fills what is transparent in it.

    Raises:
        DataError: the photo is damaged.
    """
    if shown == RENDER:
        return render
    photo = np.ascontiguousarray(view.photo.planes(background).transpose(1, 2, 0))
    placed, (top, left, bottom, right) = _placed(photo, camera, view.camera)
    result = render.copy()
    inside = render[top:bottom, left:right]
    if shown == ERROR:
        placed = error_map(placed, np.ascontiguousarray(inside))
        if (used := view.used()) is not None:  # masked pixels have no error
            mask = np.repeat(used[..., None] * np.uint8(255), 3, axis=2)
            placed = placed * (_placed(mask, camera, view.camera)[0] >= USED)
    if shown == HALVES:
        middle = (right - left) // 2
        result[top:bottom, left : left + middle] = placed[:, :middle]
        return result
    result[top:bottom, left:right] = placed
    return result


def _placed(
    photo: Picture, camera: Camera, taken: Camera
) -> tuple[Picture, tuple[int, int, int, int]]:
    """The photo as ``camera`` sees it, and its box (top, left, bottom, right) in the picture."""
    from PIL import Image

    x, y = camera.fx / taken.fx, camera.fy / taken.fy
    left, top = camera.cx - taken.cx * x, camera.cy - taken.cy * y
    box = [round(top), round(left), round(top + taken.height * y), round(left + taken.width * x)]
    box = [max(0, box[0]), max(0, box[1]), min(camera.height, box[2]), min(camera.width, box[3])]
    box[2], box[3] = max(box[2], box[0] + 1), max(box[3], box[1] + 1)
    source = (
        max(0.0, (box[1] - left) / x),
        max(0.0, (box[0] - top) / y),
        min(photo.shape[1], (box[3] - left) / x),
        min(photo.shape[0], (box[2] - top) / y),
    )
    size = box[3] - box[1], box[2] - box[0]
    resized = Image.fromarray(photo).resize(size, Image.Resampling.LANCZOS, box=source)
    return np.asarray(resized, np.uint8), (box[0], box[1], box[2], box[3])


def names_of(views: Sequence[View]) -> list[str]:
    """Names to choose photos by, all different."""
    seen: dict[str, int] = {}
    names = []
    for view in views:
        count = seen[view.name] = seen.get(view.name, 0) + 1
        names.append(view.name if count == 1 else f"{view.name} ({count})")
    return names


VIEWS, SIDE = 24, 400
"""This many cameras, with pictures whose sides have this many pixels, show what matters most."""

MOVING_SECONDS = 0.08
"""The time that a picture may take while the camera moves."""

MOVING_LEAST = 96
"""The fewest rows of a picture."""

STILL_SECONDS = 0.15
"""A camera that has not moved for this long stands still."""

MAX_SIDE = 4096


@dataclass(frozen=True)
class Eye:
    """A camera as a browser has it, scene units, OpenCV's axes.

    wxyz (4,): camera to world; position (3,); fov: vertical, radians; size: (width, height) of the
    window, pixels.
    """

    wxyz: npt.NDArray[np.float64]
    position: npt.NDArray[np.float64]
    fov: float
    size: tuple[int, int]

    def camera(self, rows: int) -> Camera:
        """The camera of a picture with ``rows`` rows, as wide as the window is.

        Raises:
            DataError: the browser sent what is no camera.
        """
        width, height = self.size
        rows = max(1, min(rows, height, MAX_SIDE))
        columns = max(1, min(round(rows * width / height), MAX_SIDE))
        if not np.any(self.wxyz):
            raise DataError("a camera whose rotation has length 0; reload the page")
        to_world = Rotation.from_quat(np.roll(self.wxyz, -1)).as_matrix()
        return pinhole(to_world.T, self.position, np.degrees(self.fov), (columns, rows))


def eye_of(camera: Camera, size: tuple[int, int]) -> Eye:
    """The eye that stands where ``camera`` does, with a window that holds all of its picture."""
    wxyz = np.roll(Rotation.from_matrix(camera.rotation.T).as_quat(), 1)
    half = max(camera.height / camera.fy, camera.width / camera.fx * size[1] / size[0]) / 2
    return Eye(wxyz, camera.centre, float(2 * np.arctan(half)), size)


def scene_importance(
    device: Device,
    scene: QuantizedScene | SplatScene,
    cameras: Sequence[Camera],
    options: RenderOptions = DEFAULT,
    on_render: Callable[[], None] = lambda: None,
) -> npt.NDArray[np.float64]:
    """(N,) float64 of the anchors or Gaussians, larger for those that matter more.

    The importance of anchors is that of ``clgs encode --target-size``: what some of ``cameras``
    lose without them, or without cameras the area that they cover.
    """
    if isinstance(scene, SplatScene):
        return splat_importance(scene.gaussians)
    if not cameras:
        return importance_without_views(scene)
    uploaded = upload_scene(device, scene.dequantize())
    seen = chosen(cameras)
    found = sensitivity(device, uploaded, scene.settings, seen, options, False, on_render)
    return found.importance.astype(np.float64)


def chosen(cameras: Sequence[Camera]) -> list[Camera]:
    """Up to VIEWS of ``cameras``, evenly spread, with smaller pictures."""
    step = max(1, -(-len(cameras) // VIEWS))
    return [one.reduced(-(-max(one.width, one.height) // SIDE)) for one in cameras[::step]]


def splat_importance(gaussians: HostGaussians) -> npt.NDArray[np.float64]:
    """(N,) float64: opacity times the area of the two longest axes."""
    opacity = 1 / (1 + np.exp(-np.clip(gaussians.opacity.astype(np.float64), -50, 50)))
    area = np.sort(gaussians.log_scale.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    return np.asarray(opacity * np.exp(np.clip(area, -80.0, 80.0)))


class LiveScene:
    """A scene of which more or less is drawn. Several threads may ask for pictures."""

    def __init__(
        self,
        device: Device,
        scene: Scene | SplatScene,
        importance: npt.NDArray[np.float64],
        options: RenderOptions = DEFAULT,
    ) -> None:
        """``importance`` (N,): of every anchor or Gaussian; the least important go first."""
        self._device, self._scene, self._options = device, scene, options
        self._order = np.argsort(-importance, kind="stable")
        self._lock = threading.Lock()
        self._share, self._renderer = 1.0, Renderer(device, scene, options)
        self._seconds_by_pixel = 0.0

    def __len__(self) -> int:
        return len(self._order)

    def kept(self, share: float) -> int:
        """How many anchors or Gaussians a share from 0 to 1 is; not 0 if there are any."""
        return min(len(self), max(1, round(share * len(self))))

    def picture(self, camera: Camera, share: float = 1.0) -> Picture:
        """The picture (H, W, 3) uint8 of the most important ``share`` of the scene."""
        with self._lock:
            if share != self._share:
                self._renderer = Renderer(self._device, self._part(share), self._options)
                self._share = share
            start = time.perf_counter()
            image = to_8bit(self._renderer.render(camera))
            seconds = time.perf_counter() - start
            self._seconds_by_pixel = seconds / (camera.width * camera.height)
            return image

    def moving_rows(self, eye: Eye) -> int:
        """Rows of a picture that takes MOVING_SECONDS at the speed of the last one."""
        if not self._seconds_by_pixel:
            return MOVING_LEAST
        pixels = MOVING_SECONDS / self._seconds_by_pixel
        rows = int(np.sqrt(pixels * eye.size[1] / eye.size[0]))
        return min(eye.size[1], max(MOVING_LEAST, rows))

    def _part(self, share: float) -> Scene | SplatScene:
        rows = np.sort(self._order[: self.kept(share)])
        scene = self._scene
        if isinstance(scene, SplatScene):
            gaussians = scene.gaussians.map(lambda array: array[rows])
            return SplatScene(gaussians, scene.settings, scene.transform)
        return Scene(take(scene.anchors, rows), scene.mlps, scene.settings, scene.transform)


class Follower:
    """Draws, in a thread of its own, after every move: coarse ones at once, a fine one at rest.

    Moves that come while it draws are one move.
    """

    def __init__(self, draw: Callable[[bool], None], rest: float = STILL_SECONDS) -> None:
        """``draw(moving)`` is called in the thread; ``rest``: seconds until a camera stands."""
        self._draw, self._rest = draw, rest
        self._moved, self._ended = threading.Event(), False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def move(self) -> None:
        """Something changed."""
        self._moved.set()

    def stop(self) -> None:
        """Draw nothing more; waits for the thread."""
        self._ended = True
        self._moved.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        while True:
            self._moved.wait()
            while self._moved.is_set() and not self._ended:
                self._moved.clear()
                self._draw(True)
                self._moved.wait(self._rest)
            if self._ended:
                return
            self._draw(False)
