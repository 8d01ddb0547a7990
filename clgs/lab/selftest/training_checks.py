"""The stages outside of a scene's render, from scan and sort to mask, splats and match."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from statistics import median

import numpy as np

from clgs.constants import FEATURE_DIM, K_OFFSETS, NEAR_PLANE, OUTPUT_DIM
from clgs.lab.figures import finished_times
from clgs.lab.scenes import camera_of
from clgs.lab.selftest.rasteriser_checks import check_channels, check_harmonics, check_views
from clgs.lab.selftest.reference_render import (
    Check,
    Timed,
    failed,
    largest,
    relative_errors,
    relative_l2,
)
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops import (
    adam,
    batch,
    density,
    exposure,
    growth,
    mask,
    match,
    quantize,
    rate,
    scan,
    sort,
)
from clgs.ops.general import splats
from clgs.ops.neural import GaussianGradients
from clgs.reference import adam as adam_reference
from clgs.reference import batch as batch_reference
from clgs.reference import density as density_reference
from clgs.reference import exposure as exposure_reference
from clgs.reference import growth as growth_reference
from clgs.reference import mask as mask_reference
from clgs.reference import match as match_reference
from clgs.reference import neural as neural_reference
from clgs.reference import quantize as quantize_reference
from clgs.reference import rate as rate_reference
from clgs.reference import scan as scan_reference
from clgs.reference import sort as sort_reference
from clgs.reference.general import splats as splats_reference
from clgs.scene.anchors import AnchorSet
from clgs.scene.gaussians import OrdinaryGaussians

COUNT, SEED, REPEATS = 20_000, 5, 3


def training_checks(device: Device, count: int = COUNT) -> Iterator[Check]:
    """Every check, on ``count`` numbers; one that raises has failed."""
    rng = np.random.default_rng(SEED)
    numbers = check_scan, check_sort, check_quantize, check_rate, check_adam, check_means
    pictures = check_exposure, check_mask, check_splats, check_match
    rasteriser = check_views, check_harmonics, check_channels
    for check in (*numbers, check_density, check_growth, *pictures, *rasteriser):
        try:
            for stage, quantity, error, limit, work in check(device, rng, count):
                times = finished_times(device, work, REPEATS)
                yield Check(stage, quantity, error, limit, median(times))
        except Exception as problem:  # a driver may raise anything
            yield failed(check.__name__.removeprefix("check_"), problem)


def check_scan(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Prefix sums and their total."""
    counts = rng.integers(0, 50, count).astype(np.int32)
    uploaded = device.upload(counts)
    offsets, total = scan.exclusive(device, uploaded)
    wanted, wanted_total = scan_reference.exclusive(counts)
    error = largest(device.download(offsets), wanted) + abs(total - wanted_total)
    yield "scan", "offsets and total", error, 0.0, partial(scan.exclusive, device, uploaded)


def check_sort(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """The order of keys, of which many are equal."""
    keys = rng.integers(0, 2**32, count).astype(np.uint32)
    keys[::3] = keys[0]
    values = np.arange(count, dtype=np.int32)
    sort_keys = partial(sort.by_key, device, device.upload(keys), device.upload(values), 32)
    error = largest(device.download(sort_keys()[1]), sort_reference.by_key(keys, values, 32)[1])
    yield "sort", "order", error, 0.0, sort_keys


def check_quantize(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Rounded values, integers, and a Q per element."""
    x = (rng.normal(0, 4, count)).astype(np.float32)
    uploaded = device.upload(x)
    forward = partial(quantize.forward, device, [(uploaded, 8.0)])
    error = largest(device.download(forward()[0]), quantize_reference.forward(x, 8.0))
    integers = device.download(quantize.integers(device, uploaded, 8.0))
    error += largest(integers, quantize_reference.integers(x, 8.0))
    q = (2.0 ** rng.integers(0, 12, count)).astype(np.float32)
    each = device.download(quantize.elements(device, uploaded, device.upload(q)))
    error += largest(each, quantize_reference.elements(x, q))
    yield "quantize", "values and integers", error, 0.0, forward


def check_rate(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Bits and gradient of both forms of the rate proxy."""
    x = rng.laplace(0.3, np.arange(1, 7), (count // 6, 6)).astype(np.float32)
    uploaded = device.upload(x)
    symbols = rate_reference.symbols(x, 1.0)
    forms: tuple[rate.Form, ...] = ("channel", "pooled")
    for form in forms:
        forward = partial(rate.forward, device, uploaded, 1.0, form)
        result, d_x = forward(), device.zeros(x.shape)
        rate.backward(device, [(rate.slopes(device, result, 1.0), uploaded, d_x)])
        bits = np.array([rate_reference.forward(symbols, form)])
        gradient = rate_reference.backward(symbols, form)
        yield "rate", f"bits ({form})", relative_l2(np.array([result.bits]), bits), 1e-6, forward
        yield "rate", f"d_x ({form})", relative_l2(device.download(d_x), gradient), 1e-5, forward


def check_adam(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """A parameter after ten steps."""
    parameter, gradient = rng.normal(size=(2, count)).astype(np.float32)
    uploaded = device.upload(parameter)
    moments, stop = adam.zero_moments(device, uploaded), adam.stop_flag(device)
    trained = adam.Trained(uploaded, device.upload(gradient), moments)
    wanted, d_wanted = parameter.astype(np.float64), gradient.astype(np.float64)
    state = np.zeros(count), np.zeros(count)

    def step(number: int) -> None:
        adam.step(device, [adam.Update(trained, adam.factors(0.01, number))], stop)

    for number in range(1, 11):
        step(number)
        wanted, state = adam_reference.step(wanted, d_wanted, state, 0.01, number)
    error = largest(device.download(uploaded), wanted)
    # ten roundings of values up to 8
    yield "adam", "parameter after 10 steps", error, 10 * 8 * 2.0**-24, lambda: step(11)


def check_means(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """The mean gradient of the views of a batch, and the mean of parameters over steps."""
    given = rng.normal(size=(3, count)).astype(np.float32)
    uploaded, wide = [device.upload(one) for one in given], given.astype(np.float64)
    total, mean = device.upload(given[0]), device.zeros((count,))
    batch.add(device, total, uploaded[1])
    batch.add(device, total, uploaded[2], 1.0 / 3.0)
    error = largest(device.download(total), batch_reference.mean(list(wide)))
    add = partial(batch.add, device, total, uploaded[1])
    # a few roundings of values up to 8
    yield "adam", "mean gradient of 3 views", error, 4 * 8 * 2.0**-24, add
    stop = adam.stop_flag(device)
    for number, one in enumerate(uploaded, start=1):
        adam.average(device, mean, one, number, stop)
    error = largest(device.download(mean), adam_reference.average(list(wide)))
    again = partial(adam.average, device, mean, uploaded[0], 4, stop)
    yield "adam", "mean over 3 steps", error, 6 * 8 * 2.0**-24, again


def check_density(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """The statistics of anchors that a view sees."""
    anchors = count // K_OFFSETS
    output = rng.uniform(-1, 1, (OUTPUT_DIM, anchors)).astype(np.float32)
    visible = np.sort(rng.permutation(2 * anchors)[:anchors]).astype(np.int32)
    slot = np.flatnonzero(output[:K_OFFSETS].T.ravel() > 0).astype(np.int32)
    extent = rng.uniform(-1, 1, (len(slot), 2)).astype(np.float32)
    d_mean2d = rng.normal(size=(len(slot), 2)).astype(np.float32)
    statistics = density.zeros(device, 2 * anchors)
    seen = density.SeenView(
        output=device.upload(output),
        visible=device.upload(visible),
        slot=device.upload(slot),
        extent=device.upload(extent),
        d_mean2d=device.upload(d_mean2d),
        size=(320, 200),
    )
    density.accumulate(device, statistics, seen)
    wanted = density_reference.zeros(2 * anchors)
    gaussians = slot, extent.astype(np.float64), d_mean2d.astype(np.float64)
    density_reference.accumulate(wanted, output.astype(np.float64), visible, gaussians, (320, 200))
    errors = relative_errors(device, statistics, wanted, [name for name, _ in statistics.items()])
    accumulate = partial(density.accumulate, device, statistics, seen)
    yield "density", "sums and counts", max(errors.values()), 1e-6, accumulate


def check_growth(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Features of new anchors."""
    anchors = max(count // K_OFFSETS, 1)
    shapes = (anchors, 3), (anchors, K_OFFSETS, 3), (anchors, FEATURE_DIM), (anchors, 6)
    host = AnchorSet(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))
    sizes = rng.integers(1, 5, anchors // 20 + 1)
    new = growth.NewAnchors(
        rng.normal(size=(len(sizes), 3)).astype(np.float32),
        rng.normal(size=len(sizes)).astype(np.float32),
        np.append(0, np.cumsum(sizes)).astype(np.int32),
        rng.integers(0, anchors, int(sizes.sum())).astype(np.int32),
    )
    wanted = growth_reference.features(host.feature.astype(np.float64), new.first, new.parents)
    append = partial(growth.append, device, host.map(device.upload), new)
    longer = device.download(append().feature)
    error = largest(longer, np.concatenate([host.feature, wanted]))
    yield "growth", "features", error, 0.0, append

    sums = rng.random((anchors, K_OFFSETS)).astype(np.float32)
    times = rng.integers(0, 90, sums.shape).astype(np.int32)
    statistics = density.zeros(device, anchors)
    device.write(statistics.gradient_sum, sums)
    device.write(statistics.gradient_count, times)
    ask = partial(growth.asking, device, statistics, 40, 0.01)
    wrong = len(
        set(ask())
        ^ set(growth_reference.asking(sums.astype(np.float64), times, 40, float(np.float32(0.01))))
    )
    yield "growth", "slots that ask", float(wrong), 0.0, ask


def check_exposure(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """A mapped picture, and the gradients of picture and map."""
    shape = 3, 1, count
    image, d_picture = rng.normal(size=(2, *shape)).astype(np.float32)
    maps = (np.eye(3, 4) + rng.normal(0, 0.2, (2, 3, 4))).astype(np.float32)
    uploaded, d_uploaded, on_device = map(device.upload, (image, d_picture, maps))
    d_maps, weight = device.zeros(maps.shape), 0.5
    forward = partial(exposure.forward, device, uploaded, on_device, 1)
    arrays = uploaded, d_uploaded, on_device
    backward = partial(exposure.backward, device, *arrays, 1, weight, d_maps)
    wide = image.astype(np.float64), d_picture.astype(np.float64), maps[1].astype(np.float64)
    error = relative_l2(device.download(forward()), exposure_reference.forward(wide[0], wide[2]))
    yield "exposure", "picture", error, 1e-6, forward
    d_image, d_map = exposure_reference.backward(*wide, weight)
    error = relative_l2(device.download(backward()), d_image)
    error += relative_l2(device.download(d_maps)[1], d_map)
    yield "exposure", "d_image and d_map", error, 1e-5, backward


def check_mask(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """A masked picture, and its gradient."""
    image = rng.normal(size=(3, 1, count)).astype(np.float32)
    used = rng.integers(0, 2, (1, count)).astype(np.uint8)
    uploaded = device.upload(image), device.upload(used)
    wide = image.astype(np.float64)
    forward = partial(mask.forward, device, *uploaded)
    error = largest(device.download(forward()), mask_reference.forward(wide, used))
    d_image = device.download(mask.backward(device, *uploaded))
    error += largest(d_image, mask_reference.backward(wide, used))
    yield "mask", "picture and d_image", error, 0.0, forward


def check_splats(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """Ordinary Gaussians as a camera sees them, and their gradients."""
    widths = {"mean": (3,), "log_scale": (3,), "rotation": (4,), "opacity": (), "sh": (16, 3)}
    values = [0.3 * rng.normal(size=(count, *width)) for width in widths.values()]
    stored = OrdinaryGaussians(*(value.astype(np.float32) for value in values))
    stored.sh[:, 0] += 3  # no color is near 0, where its gradient has a step
    uploaded = stored.map(device.upload)
    packed = camera_of(64, 64).pack(NEAR_PLANE)
    camera = device.upload(packed)
    forward = partial(splats.forward, device, uploaded, camera)
    seen = forward()
    wide = splats_reference.Stored(*(array.astype(np.float64) for _, array in stored.items()))
    wanted = splats_reference.forward(wide, packed)
    errors = relative_errors(device, seen, wanted, ("scale", "rotation", "color", "opacity"))
    yield "splats", "what a camera sees", max(errors.values()), 1e-5, forward

    names = ("mean", "scale", "rotation", "color", "opacity")
    singles = [np.ones(getattr(wanted, name).shape, np.float32) for name in names]
    d_seen = neural_reference.Gaussians(*(one.astype(np.float64) for one in singles))

    def backward() -> OrdinaryGaussians[DeviceArray]:
        ones = (device.upload(one) for one in singles)
        return splats.backward(device, uploaded, camera, seen, GaussianGradients(*ones))

    expected = splats_reference.backward(wide, packed, d_seen)
    errors = relative_errors(device, backward(), expected, widths)
    yield "splats", "gradients", max(errors.values()), 1e-5, backward


def check_match(device: Device, rng: np.random.Generator, count: int) -> Iterator[Timed]:
    """The nearest descriptors of another photo; half of them are there, some of these twice."""
    photos = [
        rng.integers(0, 60, (count // part + 1, match.LENGTH)).astype(np.uint8) for part in (40, 30)
    ]
    half = len(photos[0]) // 2
    photos[1][:half] = photos[0][rng.integers(0, len(photos[0]), half)]
    uploaded = match.upload(device, photos)
    nearest = partial(match.nearest, device, uploaded, uploaded, [(0, 1), (1, 0)])
    wanted = [match_reference.nearest(*photos), match_reference.nearest(*photos[::-1])]
    pairs = zip(nearest(), wanted, strict=True)
    wrong = sum(
        int((mine != expected).sum())
        for one, three in pairs
        for mine, expected in zip((one.index, one.product, one.second), three, strict=True)
    )
    yield "match", "nearest descriptors", float(wrong), 0.0, nearest
