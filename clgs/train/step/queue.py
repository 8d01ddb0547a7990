"""One training step: all of its work is put in the devices' queues, and waited for later."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_

import numpy as np

from clgs.data.dataset import Dataset
from clgs.opencl.device import Device
from clgs.opencl.transfer import Download
from clgs.ops import density, exposure, loss
from clgs.render.frame import EXACT_ROOM, DeviceScene, Frame, Room
from clgs.render.rasterise import rasterise
from clgs.train.config import TrainConfig
from clgs.train.rate.rate_term import RateTerm
from clgs.train.state.rounding import Rounding
from clgs.train.state.run_state import ExposureMaps, RunState
from clgs.train.step import optimizer
from clgs.train.step.batch import Batch, OtherDevice, hand_out
from clgs.train.step.grow_and_prune import replaces_anchors
from clgs.train.step.look import Look, Looks, ViewInput
from clgs.train.step.optimizer import Optimizer
from clgs.train.step.schedule import reduction


@dataclass(frozen=True)
class StepInput:
    """What a step needs in addition to the state of the run: its number, and its views."""

    step: int
    views: tuple[ViewInput, ...]


@dataclass(frozen=True)
class Enqueued:
    """A step in the queues of the devices, and its pending downloads.

    losses: of its views; totals: numbers of visible anchors, Gaussians and tile entries of each,
    (3,) int64; room: what there was for them; stops: (1,) int32 each, not 0 if the step, or one
    before it, changed nothing because it lacked room or met a number that is not finite; rate_bits:
    per anchor, if the rate proxy ran; frame: of the first view, if the host needs it to change the
    anchors; kept: what the first device reads of the others until the step is done.
    """

    given: StepInput
    losses: tuple[loss.LaterValue, ...]
    totals: tuple[Download, ...]
    room: Room
    stops: tuple[Download, ...]
    rate_bits: float | None
    frame: Frame | None
    kept: tuple[Look, ...]

    @property
    def stop(self) -> int:
        """Why the step changed nothing, 0 if it, and all before it, did; waits for it."""
        return reduce(or_, (int(stop.get()[0]) for stop in self.stops))

    def loss(self) -> loss.LossValue:
        """The mean of the views; waits for the step."""
        values = [one.get() for one in self.losses]
        l1, ssim, value = (
            sum(getattr(one, name) for one in values) / len(values)
            for name in ("l1", "ssim", "value")
        )
        return loss.LossValue(l1, ssim, value)

    def needed(self) -> Room:
        """The most visible anchors, Gaussians and entries of any view; waits for the step."""
        return Room(*map(int, np.max([one.get() for one in self.totals], axis=0)))


class StepQueue:
    """Enqueues steps. Once its stop flag is set they change nothing.

    With ``room`` EXACT_ROOM a step waits for the device three times per view. The views of a batch
    are dealt to the devices in turn. What they leave is added up by the first device in the order
    of the views, so that a step has the same bits wherever its views were looked at.
    """

    def __init__(
        self,
        device: Device,
        dataset: Dataset,
        config: TrainConfig,
        rounding: Rounding,
        others: Sequence[Device] = (),
    ) -> None:
        """Prepare the steps of a run; ``config`` is resolved for the dataset.

        ``others``: devices that the views after the first one of a batch are dealt to, and then
        ``device`` again, and so on; it may be among them, and each may be there several times.
        """
        self._device, self._config, self._rounding = device, config, rounding
        self._optimizer = Optimizer(device, config, dataset.radius)
        self._looks = Looks(device, dataset, config)
        made = {
            other: OtherDevice(other, dataset, config) for other in others if other is not device
        }
        self._others = list(made.values())
        self._turns = [made.get(each) for each in (device, *others)]
        self._rate = RateTerm(device, config)
        self.room = EXACT_ROOM
        self._sizes = self.room, 0

    @property
    def waits(self) -> bool:
        """Whether steps wait for the one before them: other devices look at what it has made."""
        return bool(self._others)

    def next_input(self, state: RunState, step: int) -> StepInput:
        """Take the views and the backgrounds of step number ``step`` from ``state``."""
        views = state.views.take(self._config.batch)
        color = self._looks.photos.color
        return StepInput(step, tuple(ViewInput(index, color(state.rng)) for index in views))

    def prepare(self, indices: Sequence[int], step: int) -> None:
        """Have the photos of the steps from number ``step`` on read ahead of them."""
        size, factor = self._config.batch, reduction(self._config, step)
        dealt: dict[Looks, list[int]] = {self._looks: []}
        dealt |= {other.looks: [] for other in self._others}
        for number, index in enumerate(indices):
            other = self._turns[number % size % len(self._turns)]
            dealt[other.looks if other else self._looks].append(index)
        for looks, own in dealt.items():
            looks.photos.prepare(own, factor)

    def clear(self) -> None:
        """Let the steps enqueued from now on change the parameters again."""
        self._device.fill_zero(self._looks.stop)
        for other in self._others:
            other.device.fill_zero(other.looks.stop)

    def enqueue(self, given: StepInput, state: RunState) -> Enqueued:
        """Enqueue a step; anchors that are about to be replaced are not updated."""
        device, config, room = self._device, self._config, self.room
        parameters, step, stop = state.parameters, given.step, self._looks.stop
        if self._sizes != (room, parameters.rows):
            self._sizes = room, parameters.rows
            for each in (device, *(other.device for other in self._others)):
                each.release_unused()
        scene = self._rounding.scene_at(state, step)
        batch, stops = Batch(device, len(given.views)), []
        frame: Frame | None = None
        for look, stopped in self._look(given, scene, state.exposures, room):
            batch.add(look)
            frame = frame or look.frame
            if stopped:  # on another device; what this one has found is downloaded before
                stops.append(device.download_later(stop))
                device.write(stop, np.array([stopped], np.int32))
        assert frame is not None, "the first view is this device's"
        bits = self._rate.add(state.rate, parameters, batch.gradients, step)
        replaces = replaces_anchors(config, step)
        with device.stage("adam"):
            learn = not replaces and step <= config.freeze_step
            found = batch.gradients, batch.partials
            self._optimizer.step(parameters, *found, learn, step, stop, state.begun)
            if state.exposures is not None:
                photos = [view.index for view in given.views]
                self._looks.exposure.learn(state.exposures, photos, step, stop)
            optimizer.extend(device, config, state, step, stop)
        with device.stage("density"):
            for seen in batch.seen:
                density.accumulate(device, parameters.statistics, seen, stop)
        enqueued = Enqueued(
            given=given,
            losses=tuple(batch.losses),
            totals=tuple(batch.totals),
            room=frame.room,
            stops=(*stops, device.download_later(stop)),
            rate_bits=bits,
            frame=frame if replaces else None,
            kept=tuple(batch.kept),
        )
        device.flush()
        return enqueued

    def _look(
        self, given: StepInput, scene: DeviceScene, exposures: ExposureMaps | None, room: Room
    ) -> Iterator[tuple[Look, int]]:
        """The looks at the views in their order, and the stop flags of the other devices.

        Those begin before this device does. If there are any, this waits for each of their looks.
        """
        step, own = given.step, self._looks
        learn = [
            exposures is not None and own.exposure.learn_at(step, place)
            for place in range(len(given.views))
        ]
        maps = exposures.maps if exposures is not None and any(learn) else None
        if self._others:
            hand_out(self._device, self._others, scene, maps)
        for place, view in enumerate(given.views):
            if other := self._turns[place % len(self._turns)]:
                other.begin(step, view, learn[place], room)
        for place, view in enumerate(given.views):
            if other := self._turns[place % len(self._turns)]:
                look, stopped = other.fetch(self._device)
                if look.d_maps is not None:
                    row = exposure.MAP_SIZE * view.index, exposure.MAP_SIZE
                    self._device.copy_part(look.d_maps, own.exposure.gradient, *row)
                yield look, stopped
            else:
                yield own.enqueue(scene, maps if learn[place] else None, step, view, room), 0
                self._device.flush()

    def render(self, step: int, view: ViewInput, state: RunState) -> Frame:
        """Render what a step compares with a photo; arrays have their exact sizes."""
        scene, looks = self._rounding.scene_at(state, step), self._looks
        return rasterise(self._device, scene, looks.target(step, view).view, looks.options)
