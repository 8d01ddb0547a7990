"""Adam on device-resident parameters, one fused kernel for many tensors (Kingma and Ba 2015).

    m = beta1 m + (1 - beta1) g,   v = beta2 v + (1 - beta2) g^2,
    p = p - m / (sqrt(v) / sqrt(1 - beta2^t) + epsilon) * learning_rate / (1 - beta1^t)

Dense: every element of a tensor is updated in every step. By rows: only rows that received a
gradient are updated, and the others keep parameter and moments (gsplat calls that selective; t
still counts all steps). The factors that depend on t are computed in double on the host. Moments
too small to matter become zero, so that those of rows that get no gradient do not decay into
subnormals.

A batch of B views takes the learning rate times sqrt(B) and beta^B, so that the mean of its
gradients moves parameters about as B steps of one view do (Malladi et al. 2022; Grendel-GS, which
trains with these two rules).
``clgs.train.step.numpy_adam`` is the same update in NumPy, equal to the bit if division and roots
are correctly rounded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.grid import by_items, by_parts, filled
from clgs.shapes import Shaped, Shapes

Array = TypeVar("Array", bound=Shaped)
Other = TypeVar("Other", bound=Shaped)
Item = TypeVar("Item")

EPSILON = 1e-15
MIN_FIRST_MOMENT = 1e-30
MIN_SECOND_MOMENT = 1e-36
"""Moments below these are set to zero; kernels_cl/adam/adam.cl says why there are two sizes."""

NOT_FINITE = 1
"""The bit of the stop flag that says that a gradient was infinite or NaN."""

ELEMENTS_PER_ITEM = 256
"""Elements that a work-item of :func:`check_finite` looks at."""

CHECKED_ARRAYS, UPDATED_PARTS = 5, 6
"""The most arrays that a launch checks, and the most parts that it updates."""

PARTS_WIDTH = 8
"""Length of the vectors that hold one number per array or part."""


@dataclass(frozen=True)
class Moments(Generic[Array]):
    """Running means of the gradient and of its square, float32, shaped like the parameter."""

    first: Array
    second: Array

    def items(self) -> Iterator[tuple[str, Array]]:
        """(name, array) of both."""
        yield from (("first", self.first), ("second", self.second))

    def map(self, change: Callable[[Array], Other]) -> Moments[Other]:
        """The moments that ``change`` makes of both, for example ``device.upload``."""
        return Moments(change(self.first), change(self.second))


DeviceMoments = Moments[DeviceArray]


@dataclass(frozen=True)
class Trained:
    """A float32 tensor of any shape, with its gradient and moments of as many elements."""

    parameter: DeviceArray
    gradient: DeviceArray
    moments: DeviceMoments

    def check(self) -> None:
        """Raise ValueError if a size or dtype differs."""
        for name, array in (("gradient", self.gradient), *self.moments.items()):
            if array.size != self.parameter.size or array.dtype != np.float32:
                wrong = f"{array.dtype}{array.shape}"
                raise ValueError(f"{name}: {wrong} does not fit {self.parameter.shape}")

    def arguments(self, part: str = "") -> dict[str, DeviceArray]:
        """The arrays as arguments of the kernels; ``part``: the number that ends their names."""
        return {
            f"parameter{part}": self.parameter,
            f"gradient{part}": self.gradient,
            f"first{part}": self.moments.first,
            f"second{part}": self.moments.second,
        }


@dataclass(frozen=True)
class Betas:
    """The shares of the two moments that an update keeps."""

    first: float = 0.9
    second: float = 0.999

    def of_batch(self, views: int) -> Betas:
        """The betas of a batch: an update forgets as much as that many updates do."""
        return Betas(self.first**views, self.second**views)


BETAS = Betas()


@dataclass(frozen=True)
class StepFactors:
    """What changes from step to step: ``correction`` of the root, and the ``step`` length."""

    correction: float
    step: float
    betas: Betas = BETAS


def factors(learning_rate: float, count: int, betas: Betas = BETAS) -> StepFactors:
    """Bias-corrected factors of update number ``count``, which starts at 1; double precision."""
    return StepFactors(
        correction=(1.0 - betas.second**count) ** -0.5,
        step=learning_rate / (1.0 - betas.first**count),
        betas=betas,
    )


def zero_moments(device: Device, parameter: DeviceArray) -> DeviceMoments:
    """Moments before the first step."""
    return Moments(device.zeros(parameter.shape), device.zeros(parameter.shape))


def stop_flag(device: Device) -> DeviceArray:
    """(1,) int32 holding 0: steps may be made. Other values stop them until someone clears it."""
    return device.zeros((1,), np.int32)


def check_finite(device: Device, arrays: Iterable[DeviceArray], stop: DeviceArray) -> None:
    """Set NOT_FINITE in ``stop`` if an element of a float32 array is infinite or NaN."""
    kernel = device.kernel("adam/adam", "adam_check", **_DEFINES)
    for some in _batches([array for array in arrays if array.size], CHECKED_ARRAYS):
        sizes = np.zeros(PARTS_WIDTH, np.uint32)
        sizes[: len(some)] = [array.size for array in some]
        values = {f"values{i}": array for i, array in enumerate(filled(some, CHECKED_ARRAYS))}
        grid = by_parts(sizes.tolist(), ELEMENTS_PER_ITEM)
        device.run(kernel, *grid, **values, sizes=sizes, stop=stop)


def mark_rows(device: Device, gradient: DeviceArray, stop: DeviceArray) -> DeviceArray:
    """(rows,) int32: 1 if the row of ``gradient`` (rows, ...) float32 is not all zero, else 0.

    Checks the gradient, too, as :func:`check_finite` does.
    """
    rows = len(gradient)
    marks = device.empty((rows,), np.int32)
    if gradient.size:
        width = gradient.size // rows
        device.run(
            device.kernel("adam/adam", "adam_mark", WIDTH=width, **_DEFINES),
            *by_items(rows),
            values=gradient,
            rows=np.uint32(rows),
            stop=stop,
            marks=marks,
        )
    return marks


@dataclass(frozen=True)
class Update:
    """One step of ``trained``, with the factors of :func:`factors`; only of ``part`` if given.

    The elements of the part are counted through.
    """

    trained: Trained
    now: StepFactors
    part: slice | None = None


def step(device: Device, updates: Sequence[Update], stop: DeviceArray) -> None:
    """Update the parameters and moments of all ``updates``, which share no element, in place.

    ``stop`` (1,) int32: unless it holds 0 nothing changes.

    Raises:
        ValueError: sizes or dtypes differ, or the updates have not all the same betas.
    """
    kernel = device.kernel("adam/adam", "adam_step", **_DEFINES)
    for one in updates:
        one.trained.check()
        if one.now.betas != updates[0].now.betas:
            raise ValueError(f"betas: {one.now.betas} and {updates[0].now.betas} in one step")
    for some in _batches(updates, UPDATED_PARTS):
        starts, sizes = np.zeros((2, PARTS_WIDTH), np.uint32)
        corrections, steps = np.zeros((2, PARTS_WIDTH), np.float32)
        for i, one in enumerate(some):
            start, end, _ = (one.part or slice(None)).indices(one.trained.parameter.size)
            starts[i], sizes[i] = start, end - start
            corrections[i], steps[i] = one.now.correction, one.now.step
        tensors: dict[str, DeviceArray] = {}
        for i, one in enumerate(filled(some, UPDATED_PARTS)):
            tensors |= one.trained.arguments(str(i))
        device.run(
            kernel,
            *by_parts(sizes.tolist(), device.vec),
            **tensors,
            starts=starts,
            sizes=sizes,
            betas=_packed(updates[0].now.betas),
            corrections=corrections,
            epsilon=np.float32(EPSILON),
            steps=steps,
            stop=stop,
        )


def _batches(items: Sequence[Item], most: int) -> Iterator[Sequence[Item]]:
    return (items[i : i + most] for i in range(0, len(items), most))


def step_rows(
    device: Device,
    trained: Trained,
    factors_now: StepFactors,
    stop: DeviceArray,
    marks: DeviceArray,
) -> None:
    """Do :func:`step` for ``trained`` (rows, ...), but only in the rows that are marked.

    ``marks`` (rows,) int32, from :func:`mark_rows`: rows with 0 keep parameter and moments.

    Raises:
        ValueError, TypeError: sizes or dtypes differ.
    """
    trained.check()
    parameter = trained.parameter
    Shapes(rows=len(parameter)).check("marks", marks, "rows", np.int32)
    if not parameter.size:
        return
    width = parameter.size // len(parameter)
    device.run(
        device.kernel("adam/adam", "adam_step_rows", WIDTH=width, **_DEFINES),
        *by_items(-(-parameter.size // device.vec)),
        **trained.arguments(),
        total=np.uint32(parameter.size),
        betas=_packed(factors_now.betas),
        correction=np.float32(factors_now.correction),
        epsilon=np.float32(EPSILON),
        step=np.float32(factors_now.step),
        stop=stop,
        marks=marks,
    )


def average(
    device: Device, mean: DeviceArray, parameter: DeviceArray, count: int, stop: DeviceArray
) -> None:
    """Take ``parameter`` into ``mean``, of the same size, as number ``count``, from 1, of a mean.

    ``mean`` is zero before the first one. ``stop`` (1,) int32: unless it holds 0 nothing changes.

    Raises:
        ValueError: sizes or dtypes differ.
    """
    for name, array in (("mean", mean), ("parameter", parameter)):
        if array.size != parameter.size or array.dtype != np.float32:
            wrong = f"{array.dtype}{array.shape}"
            raise ValueError(f"{name}: {wrong}, expected float32{parameter.shape}")
    if not parameter.size:
        return
    device.run(
        device.kernel("adam/adam", "adam_average", **_DEFINES),
        *by_items(-(-parameter.size // device.vec)),
        mean=mean,
        parameter=parameter,
        total=np.uint32(parameter.size),
        share=np.float32(1.0 / count),
        stop=stop,
    )


_DEFINES = {
    "MIN_FIRST_MOMENT": MIN_FIRST_MOMENT,
    "MIN_SECOND_MOMENT": MIN_SECOND_MOMENT,
    "NOT_FINITE": NOT_FINITE,
    "ELEMENTS_PER_ITEM": ELEMENTS_PER_ITEM,
}


def _packed(betas: Betas) -> npt.NDArray[np.float32]:
    """What kernels take: each share that is kept, and what is left of 1."""
    kept = betas.first, 1.0 - betas.first, betas.second, 1.0 - betas.second
    return np.array(kept, np.float32)
