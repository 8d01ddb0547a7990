"""The views of a step: some are drawn on further devices while the first one draws, too.

The first device has the state of the run. In every step it hands the others the scene as it is
drawn, and they hand back what each look left, through the host's memory: two devices need not share
a context. The first device adds up what all looks left. Nothing of the run is kept on the others,
so that growing, rounds and checkpoints know one device alone. All compute the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from clgs.data.dataset import Dataset
from clgs.errors import UsageError
from clgs.opencl.array import DeviceArray
from clgs.opencl.choose import choose_device
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import batch
from clgs.ops.density import SeenView
from clgs.ops.loss import LaterValue
from clgs.render.frame import DeviceScene, Room, SceneGradients
from clgs.scene.anchors import Anchors
from clgs.train.config import TrainConfig
from clgs.train.state.run_state import ANCHOR_GROUPS
from clgs.train.step.look import Look, Looks, ViewInput


def open_devices(names: Sequence[str]) -> list[Device]:
    """The devices of these names, in their order; one that is named twice is opened once.

    Raises:
        DeviceError, UsageError: as of :func:`clgs.opencl.choose.choose_device`, and of
            :func:`check_together`.
    """
    chosen = [choose_device(name, "--devices") for name in names]
    opened = {each: Device(cl_device=each) for each in dict.fromkeys(chosen)}
    devices = [opened[each] for each in chosen]
    check_together(devices)
    return devices


def check_together(devices: Sequence[Device]) -> None:
    """Raise UsageError if two of the devices are of different kinds."""
    for device in devices:
        if device.kind != devices[0].kind:
            raise UsageError(
                f"devices: {devices[0].name} ({devices[0].kind}) and {device.name} ({device.kind}) "
                "do not compute the same bits; name some that `clgs devices` marks alike"
            )


@dataclass(frozen=True)
class OtherLook:
    """A look in the queue of another device; stop (1,) int32 as of :class:`Looks`."""

    look: Look
    stop: Download


class OtherDevice:
    """Looks at views on another device than the one that has the state of the run."""

    def __init__(self, device: Device, dataset: Dataset, config: TrainConfig) -> None:
        """Prepare the looks of a run; ``config`` is resolved for the dataset."""
        self.device = device
        self.looks = Looks(device, dataset, config)
        self.drawn: list[DeviceArray] = []
        """The tensors of the scene and, if exposures learn, their maps, see :func:`hand_out`."""
        self._under_way: deque[OtherLook] = deque()

    def begin(self, step: int, view: ViewInput, learns: bool, room: Room) -> None:
        """Enqueue a look at ``view``; ``learns``: whether its exposure does. Waits for nothing."""
        *anchors, weights = self.drawn[:5]
        scene = DeviceScene(Anchors(*anchors), weights)
        maps = self.drawn[5] if learns else None
        look = self.looks.enqueue(scene, maps, step, view, room)
        stop = self.device.download_later(self.looks.stop)
        self._under_way.append(OtherLook(replace(look, frame=None), stop))
        self.device.flush()

    def fetch(self, first: Device) -> tuple[Look, int]:
        """The oldest look that was begun, on the device ``first``, and its stop flag; waits for it.

        If both are CPUs nothing is copied: keep the look until the work that reads it is finished.
        """
        other = self._under_way.popleft()
        look, seen = other.look, other.look.seen

        def bring(array: DeviceArray) -> DeviceArray:
            return first.share(self.device.hand_over(array))

        d = look.gradients
        gradients = replace(
            d,
            d_offset=bring(d.d_offset),
            d_feature=bring(d.d_feature),
            d_scaling=bring(d.d_scaling),
            d_weights=bring(d.d_weights),
        )
        if seen is not None:
            seen = SeenView(
                output=bring(seen.output),
                visible=bring(seen.visible),
                slot=bring(seen.slot),
                extent=bring(seen.extent),
                d_mean2d=bring(seen.d_mean2d),
                size=seen.size,
            )
        brought = replace(
            look,
            gradients=gradients,
            partials=bring(look.partials),
            seen=seen,
            d_maps=None if look.d_maps is None else bring(look.d_maps),
        )
        return brought, int(other.stop.get()[0])


def hand_out(
    first: Device, others: Sequence[OtherDevice], scene: DeviceScene, maps: DeviceArray | None
) -> None:
    """Copy what is drawn from the device ``first`` to the others, side by side; waits for it.

    ``maps``: the exposures (P, 3, 4) float32 if some learn.
    """
    arrays = [array for _, array in scene.items()] + ([] if maps is None else [maps])
    with first.mapped(*arrays) as host:
        for other in others:
            other.drawn = [other.device.upload_constant(array) for array in host]
            other.device.flush()
        for other in others:
            other.device.finish()


class Batch:
    """The looks of a step, in the order of its views.

    losses, totals, partials and seen: of each, as of :class:`Look`; seen: none if no
    statistics are taken; kept: the looks of other devices.
    """

    def __init__(self, device: Device, views: int) -> None:
        """No view has been looked at yet; there will be ``views`` of them."""
        self._device, self._views = device, views
        self._gradients: SceneGradients | None = None
        self.losses: list[LaterValue] = []
        self.totals: list[Download] = []
        self.partials: list[DeviceArray] = []
        self.seen: list[SeenView] = []
        self.kept: list[Look] = []

    @property
    def gradients(self) -> SceneGradients:
        """The mean of the gradients, once all looks are added; d_projected is the first one's."""
        assert self._gradients is not None
        return self._gradients

    def add(self, look: Look) -> None:
        """Add the next look, whose arrays are on the device or shared with it."""
        self.losses.append(look.loss)
        self.totals.append(look.totals)
        self.partials.append(look.partials)
        if look.seen is not None:
            self.seen.append(look.seen)
        if look.frame is None:
            self.kept.append(look)
        if self._gradients is None:
            self._gradients = look.gradients
            return
        scale = 1 / self._views if len(self.losses) == self._views else 1.0
        with self._device.stage("batch"):
            for name in (*ANCHOR_GROUPS, "weights"):
                total = getattr(self._gradients, f"d_{name}")
                batch.add(self._device, total, getattr(look.gradients, f"d_{name}"), scale)
