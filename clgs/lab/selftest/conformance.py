"""Fingerprints of everything that the kernels compute for fixed inputs, stage by stage."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.errors import DataError
from clgs.lab import kernels
from clgs.lab.kernels import drawn_output
from clgs.lab.scenes import (
    TURNED,
    ConformanceScene,
    ExactRandom,
    Tensor,
    conformance_scenes,
    named,
)
from clgs.lab.selftest.further_stages import (
    file_tensors,
    fisheye_tensors,
    room_tensors,
    training_tensors,
)
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import adam, blend, density, loss, match, project, quantize, rate, scan, sort
from clgs.ops.general import harmonics, views
from clgs.options import DEFAULT, PRESETS, RenderOptions
from clgs.render import channel_picture
from clgs.render.frame import DeviceScene, Frame, upload_scene, upload_view
from clgs.render.rasterise import rasterise, rasterise_backward

FORMAT = "clgs conformance 1"
VOLUME_WEIGHT = 0.0625
COUNT = 5000
"""Numbers given to the stages outside of a render."""

OPERATIONS = ("division", "square root", "product and sum", "fused product and sum")
"""What drivers round differently; all stages are made of these and of sums and products."""


@dataclass(frozen=True)
class Fingerprint:
    """SHA-256 of the little-endian bytes of one tensor."""

    scene: str
    stage: str
    tensor: str
    sha256: str

    @property
    def place(self) -> str:
        """Where it comes from, for people."""
        return f"scene {self.scene}, {self.stage}, {self.tensor}"


def fingerprints(device: Device) -> list[Fingerprint]:
    """Hash the results of every stage on every scene, in the order of the pipeline."""
    found = []
    for one in conformance_scenes():
        found += [_fingerprint(one.name, *tensor) for tensor in _render_tensors(device, one)]
    found += [_fingerprint("numbers", *tensor) for tensor in _number_tensors(device)]
    found += [_fingerprint("splats", *tensor) for tensor in _rasteriser_tensors(device)]
    large = conformance_scenes()[1]
    for name, tensors in (
        ("training", training_tensors(device)),
        ("rooms", room_tensors(device, large)),
        ("files", file_tensors(device, large)),
        ("fisheye", fisheye_tensors(device)),
    ):
        found += [_fingerprint(name, *tensor) for tensor in tensors]
    return found


def _fingerprint(scene: str, stage: str, name: str, values: npt.NDArray[Any]) -> Fingerprint:
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return Fingerprint(scene, stage, name, hashlib.sha256(little.tobytes()).hexdigest())


def _render_tensors(device: Device, one: ConformanceScene) -> Iterator[Tensor]:
    scene = upload_scene(device, one.scene)
    view = upload_view(device, one.camera, one.scene.settings)
    frame = rasterise(device, scene, view)
    yield "camera", "packed", device.download(view.camera)
    visible = device.download(frame.activations.visible)
    yield "cull", "visible", visible
    yield "mlp forward", "output", drawn_output(device, frame.activations)
    for stage, result, names in (
        ("neural forward", frame.gaussians, "slot opacity mean scale rotation color"),
        ("project forward", frame.projected, "mean2d depth whitening extent"),
        ("tiles", frame.tiles, "tile_range gaussian row"),
        ("blend forward", frame.blended, "image transmittance last_contributor"),
    ):
        yield from named(device, stage, result, *names.split())
    target = device.upload(one.photo)
    compared = loss.forward(device, frame.image, target)
    d_image = loss.backward(device, frame.image, target, compared)
    yield from named(device, "loss forward", compared, "shift")
    yield "loss backward", "d_image", device.download(d_image)
    yield from _backward_tensors(device, scene, frame, d_image)
    for name, accuracy in PRESETS.items():
        again = rasterise(device, scene, view, RenderOptions(accuracy))
        yield f"render ({name})", "image", device.download(again.image)


def _backward_tensors(
    device: Device, scene: DeviceScene, frame: Frame, d_image: DeviceArray
) -> Iterator[Tensor]:
    gaussians, projected = frame.gaussians, frame.projected
    d_projected = blend.backward(device, projected, frame.blended, d_image)
    names = ("d_color", "d_opacity", "d_mean2d", "d_whitening")
    yield from named(device, "blend backward", d_projected, *names)
    d_gaussians = project.backward(device, gaussians, frame.view.camera, projected, d_projected)
    loss.volume(device, gaussians.scale, VOLUME_WEIGHT, d_gaussians.d_scale)
    yield from named(device, "project backward", d_gaussians, "d_mean", "d_scale", "d_rotation")
    gradients = rasterise_backward(device, scene, frame, d_image, VOLUME_WEIGHT)
    yield from named(device, "neural backward", gradients, "d_offset", "d_scaling")
    yield from named(device, "mlp backward", gradients, "d_feature", "d_weights")


def _number_tensors(device: Device) -> Iterator[Tensor]:
    """The stages outside of a render, on numbers."""
    random = ExactRandom(COUNT)
    counts = (random.integers(COUNT) >> np.uint64(58)).astype(np.int32)
    yield "scan", "offsets", device.download(scan.exclusive(device, device.upload(counts))[0])
    keys = (random.integers(COUNT) >> np.uint64(50)).astype(np.uint32)
    values = np.arange(COUNT, dtype=np.int32)
    order = sort.by_key(device, device.upload(keys), device.upload(values), 14)[1]
    yield "sort", "order", device.download(order)
    x = device.upload(random.floats((COUNT // 6, 6), -20.0, 20.0))
    yield "quantize", "rounded", device.download(quantize.forward(device, [(x, 8.0)])[0])
    d_x = device.zeros(x.shape)
    slopes = rate.slopes(device, rate.forward(device, x, 8.0), 1.0)
    rate.backward(device, [(slopes, x, d_x)])
    yield "rate", "d_x", device.download(d_x)
    parameter = device.upload(random.floats((COUNT,), -1.0, 1.0))
    moments, stop = adam.zero_moments(device, parameter), adam.stop_flag(device)
    for step in range(1, 4):
        gradient = device.upload(random.floats((COUNT,), -1.0, 1.0))
        trained = adam.Trained(parameter, gradient, moments)
        adam.step(device, [adam.Update(trained, adam.factors(0.01, step))], stop)
    yield "adam", "parameter", device.download(parameter)
    anchors = COUNT // K_OFFSETS
    output = random.floats((OUTPUT_DIM, anchors), -1.0, 1.0)
    slot = np.flatnonzero(output[:K_OFFSETS].T.ravel() > 0).astype(np.int32)
    seen = density.SeenView(
        output=device.upload(output),
        visible=device.upload(np.arange(anchors, dtype=np.int32)),
        slot=device.upload(slot),
        extent=device.upload(random.floats((len(slot), 2), -1.0, 1.0)),
        d_mean2d=device.upload(random.floats((len(slot), 2), -1.0, 1.0)),
        size=(320, 200),
    )
    statistics = density.zeros(device, anchors)
    density.accumulate(device, statistics, seen)
    for name, array in statistics.items():
        yield "density", name, device.download(array)
    photos = [random.bytes((count, match.LENGTH)) // np.uint8(4) for count in (150, 230)]
    uploaded = match.upload(device, photos)
    (found,) = match.nearest(device, uploaded, uploaded, [(0, 1)])
    yield from (("match", name, values) for name, values in vars(found).items())


def _rasteriser_tensors(device: Device) -> Iterator[Tensor]:
    """What ``clgs.rasterization`` runs, on Gaussians in a box; opacities make up for the blur."""
    random, size = ExactRandom(COUNT + 2), (80, 48)
    splats = views.Splats(
        device.upload(random.floats((COUNT, 3), -1.0, 1.0)),
        device.upload(random.floats((COUNT, 3), 0.01, 0.125)),
        device.upload(random.floats((COUNT, 4), -1.0, 1.0)),
        device.upload(random.floats((COUNT,), 0.0, 1.0)),
    )
    matrix, lens = np.eye(4), views.CameraModel(compensated=True)
    matrix[:3, :3], matrix[2, 3] = TURNED, 4.0
    intrinsics = np.array([[80.0, 0, 40], [0, 80, 24], [0, 0, 1]])
    camera = device.upload(views.pack_camera(matrix, intrinsics, size, lens.near))
    sh = device.upload(random.floats((COUNT, 25, 3), -0.5, 0.5))
    color = harmonics.forward(device, splats.mean, sh, camera, 4)
    yield "harmonics forward", "color", device.download(color)
    projected = views.forward(device, splats, camera, lens, color, DEFAULT)
    names = ("mean2d", "whitening", "depth", "extent", "opacity")
    yield from named(device, "views forward", projected, *names)
    background = device.upload(random.floats((4,), 0.0, 1.0))
    drawn = channel_picture.draw(device, projected, size, background, True, 0.999, DEFAULT)
    yield from named(device, "channels forward", drawn.picture, "image", "transmittance")
    d_image = device.upload(random.floats((48, 80, 4), -1.0, 1.0))
    d_left = device.upload(random.floats((48, 80), -1.0, 1.0))
    d = channel_picture.backward(device, drawn, d_image, d_left, absolute=True)
    yield from named(device, "channels backward", d, *vars(d))
    made = views.backward(device, splats, camera, lens, projected, d, want_camera=True)
    yield from named(device, "views backward", made, *vars(made))
    d_sh, d_mean = harmonics.backward(device, splats.mean, sh, camera, 4, color, d.d_color)
    yield "harmonics backward", "d_sh", device.download(d_sh)
    yield "harmonics backward", "d_mean", device.download(d_mean)


def to_record(found: list[Fingerprint], facts: dict[str, object]) -> dict[str, object]:
    """Ready for JSON."""
    return {"format": FORMAT, **facts, "tensors": [asdict(one) for one in found]}


def from_record(record: object) -> list[Fingerprint]:
    """The mirror of :func:`to_record`.

    Raises:
        DataError: it is no such record.
    """
    try:
        assert isinstance(record, dict)
        if record["format"] != FORMAT:
            raise DataError(f"made in the form {record['format']!r}, expected {FORMAT!r}")
        found = [Fingerprint(**one) for one in record["tensors"]]
        assert all(isinstance(v, str) for one in found for v in vars(one).values())
    except (AssertionError, KeyError, TypeError, AttributeError) as error:
        raise DataError("is no file of `clgs conformance -o`") from error
    place, times = Counter(one.place for one in found).most_common(1)[0] if found else ("", 0)
    if times > 1:
        raise DataError(f"lists a tensor {times} times: {place}; make the file again")
    return found


def roundings(device: Device) -> dict[str, int]:
    """How many of COUNT results of each basic operation are not those of IEEE 754."""
    random = ExactRandom(COUNT + 1)
    x, y = random.floats((COUNT,), 1.0, 2.0), random.floats((COUNT,), 1.0, 2.0)
    z = -random.floats((COUNT,), 1.0, 4.0)
    found = device.download(kernels.rounding(device, *map(device.upload, (x, y, z))))
    wanted = kernels.exact_rounding(*(one.astype(np.float64) for one in (x, y, z)))
    wrong = (found != wanted).sum(axis=1)
    return dict(zip(OPERATIONS, map(int, wrong), strict=True))


def differences(mine: list[Fingerprint], others: list[Fingerprint]) -> list[Fingerprint]:
    """Find the fingerprints of ``mine`` that differ in ``others``, in the order of the pipeline.

    Raises:
        DataError: the lists are not of the same tensors.
    """
    theirs = {one.place: one.sha256 for one in others}
    if sorted(theirs) != sorted(one.place for one in mine):
        raise DataError("holds other tensors: it was made by another version of clgs")
    return [one for one in mine if theirs[one.place] != one.sha256]
