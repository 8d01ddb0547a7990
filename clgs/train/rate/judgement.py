"""What changes of the anchors cost in terms of the loss, to second order.

The loss goes with the root of the squared error E of the pictures, so that a change that adds e to
E adds e / (2 E) of the loss. What adds to E is estimated by ``clgs.train.quality.importance``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgs.data.view import View
from clgs.opencl.device import Device
from clgs.ops import loss, mask
from clgs.options import RenderOptions
from clgs.render.frame import EXACT_ROOM, DeviceScene, upload_view
from clgs.render.pipeline import roomy_forward
from clgs.scene.scene import RenderSettings
from clgs.train.quality.importance import Sensitivity, sensitivity

Floats = npt.NDArray[np.float64]

COMPARED = 8
"""Views on which the loss and the squared error are measured."""

PIXELS = 2.0
"""Pictures are drawn at half the resolution if this many pixels per anchor remain."""


@dataclass(frozen=True)
class Judgement:
    """What the loss gains by changes of the anchors.

    loss: of a view, the mean; importance (A,): by leaving an anchor out; curvature: of offset
    (A, K, 3), feature (A, F) and scaling (A, 6), by a change of d of one element, divided by d
    squared. Float64, at least 0. Of anchors that the judge could not see the importance is
    infinite, and the curvature the mean of the others.
    """

    loss: float
    importance: Floats
    curvature: Mapping[str, Floats]


@dataclass(frozen=True)
class _Curvature(Mapping[str, Floats]):
    """The curvature of each attribute, made when it is asked for: 700 bytes per anchor in all.

    seen: (A,), or None if nothing was unseen.
    """

    found: Mapping[str, npt.NDArray[np.float32]]
    worth: float
    seen: npt.NDArray[np.bool_] | None

    def __getitem__(self, name: str) -> Floats:
        array = self.found[name].astype(np.float64) * self.worth
        if self.seen is not None:
            array[~self.seen] = array[self.seen].mean(axis=0)
        return array

    def __iter__(self) -> Iterator[str]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)


@dataclass(frozen=True)
class Judge:
    """The views that anchors are judged by, and how they are rendered and compared.

    all_views: there are no others, so that what these do not see is seen by none.
    """

    device: Device
    views: Sequence[View]
    all_views: bool
    settings: RenderSettings
    options: RenderOptions
    weights: loss.Weights

    def look(
        self, scene: DeviceScene, first: int = 0, every: int = 1, curved: bool = True
    ) -> Sensitivity:
        """How a view, the mean, goes with the anchors, seen from the views [first::every].

        From all views if these are none. ``curved``: whether to look at changes of the attributes,
        too.
        """
        # of a single view there is no second half
        cameras = [view.camera for view in self.views[first::every] or self.views]
        least = min(camera.width * camera.height for camera in cameras)
        factor = 2 if least >= 4 * PIXELS * len(scene.anchors) else 1
        reduced = [camera.reduced(factor) for camera in cameras]
        found = sensitivity(self.device, scene, self.settings, reduced, self.options, curved)
        return found.times(factor**2 / len(cameras))

    def judge(self, scene: DeviceScene, found: Sensitivity) -> Judgement:
        """The anchors of ``scene``, by what :meth:`look` found of them."""
        mean_loss, squared_error = self.compare(scene)
        worth = 0.5 * mean_loss / squared_error
        importance = found.importance.astype(np.float64) * worth
        unseen = not self.all_views and bool(found.seen.any())
        if unseen:
            importance[~found.seen] = np.inf
        curvature = _Curvature(found.curvature, worth, found.seen if unseen else None)
        return Judgement(mean_loss, importance, curvature)

    def compare(self, scene: DeviceScene) -> tuple[float, float]:
        """Loss and squared error of a view, means over some of them."""
        device, losses, errors, room = self.device, [], [], EXACT_ROOM
        for view in self.views[:: -(-len(self.views) // COMPARED)]:
            drawn = upload_view(device, view.camera, self.settings)
            frame, room = roomy_forward(device, scene, drawn, self.options, room)
            photo = view.photo.planes(self.settings.background)
            image, used = frame.image, view.used()
            if used is not None:
                image, photo = mask.forward(device, image, device.upload(used)), photo * used
            compared = loss.forward(device, image, device.upload(photo), self.weights)
            losses.append(compared.value_later(device).get().value)
            residual = device.download(image) - photo / np.float32(255)
            errors.append(float(np.square(residual, dtype=np.float64).sum()))
            del frame, image  # before the next ones are made
        return float(np.mean(losses)), max(float(np.mean(errors)), np.finfo(np.float64).tiny)
