"""Growing and pruning in place against the plain reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from clgs.constants import FEATURE_DIM, K_OFFSETS
from clgs.ops import growth
from clgs.ops.density import Statistics
from clgs.reference import growth as reference
from clgs.scene.anchors import AnchorSet

Host = tuple[AnchorSet, "Statistics[npt.NDArray[Any]]"]


def host_arrays(rng: np.random.Generator, count: int) -> Host:
    anchors = AnchorSet(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.normal(size=(count, K_OFFSETS, 3)).astype(np.float32),
        rng.normal(size=(count, FEATURE_DIM)).astype(np.float32),
        rng.normal(size=(count, 6)).astype(np.float32),
    )
    statistics = Statistics(
        rng.random(count).astype(np.float32),
        rng.integers(1, 200, count).astype(np.int32),
        rng.random((count, K_OFFSETS)).astype(np.float32),
        rng.integers(0, 90, (count, K_OFFSETS)).astype(np.int32),
    )
    return anchors, statistics


def uploaded(device, host: Host):
    return host[0].map(device.upload), host[1].map(device.upload)


def assert_as_reference(device, there, host: Host) -> None:
    """All arrays on the device are those on the host, bit by bit."""
    for one, other in zip(there, host, strict=True):
        for (name, array), (_, wanted) in zip(one.items(), other.items(), strict=True):
            np.testing.assert_array_equal(device.download(array), wanted, err_msg=name)


def counts(host: Host):
    return host[1].visits, host[1].gradient_count


def test_hiding_what_is_not_drawn(device, rng):
    host = host_arrays(rng, 300)
    there = uploaded(device, host)
    visible = np.append(rng.permutation(300)[:130], [-1, -1]).astype(np.int32)
    output = rng.normal(-1, 1, (K_OFFSETS + 5, 160)).astype(np.float32)
    output[:K_OFFSETS, 3] = np.nan
    growth.hide_undrawn(device, *there, device.upload(visible), device.upload(output))
    seen = visible, output[:K_OFFSETS].astype(np.float64)
    reference.hide_undrawn(host[0].position, host[0].offset, counts(host), seen)
    hidden = np.isnan(host[0].position[:, 0])
    assert hidden[visible[3]]
    assert 1 < hidden.sum() < 130
    assert_as_reference(device, there, host)


@pytest.mark.parametrize("least", [0.0, 0.005, 10.0])
def test_pruning(device, rng, least):
    """Nearly none, some and nearly all of those that were visited often enough go."""
    host = host_arrays(rng, 300)
    host[1].opacity_sum[5:8], host[1].visits[5:8] = np.float32(100 * least), 100
    host[1].opacity_sum[7] = np.nan
    there = uploaded(device, host)
    rows = growth.prune(device, *there, 80, least, 0.05)
    sums = host[1].opacity_sum, host[1].visits, host[1].gradient_count
    host[1].opacity_sum[7] = -1.0  # what is not a number is not opaque
    arrays = host[0].position, host[0].scaling
    wanted = reference.prune(arrays, sums, 80, np.float32(least), np.float32(0.05))
    assert rows.tolist() == wanted
    assert 7 in wanted
    assert 5 not in wanted
    assert_as_reference(device, there, host)


@pytest.mark.parametrize("least", [0.0, 0.01, 9.0])
def test_slots_that_ask(device, rng, least):
    statistics = host_arrays(rng, 333)[1]
    found = growth.asking(device, statistics.map(device.upload), 40, least)
    sums = statistics.gradient_sum, statistics.gradient_count
    assert found.tolist() == reference.asking(*sums, 40, np.float32(least))


@pytest.mark.parametrize("count", [0, 1, 500])
def test_places_of_slots(device, rng, count):
    host = host_arrays(rng, 100)
    slots = rng.integers(0, 100 * K_OFFSETS, count)
    found = growth.places(device, uploaded(device, host)[0], slots)
    wanted = reference.places(host[0].offset, host[0].scaling, slots.astype(np.int32))
    np.testing.assert_array_equal(found, wanted)


def test_restart(device, rng):
    host = host_arrays(rng, 77)
    there = uploaded(device, host)
    growth.restart(device, there[1], 40)
    reference.restart(host[1].gradient_sum, host[1].gradient_count, 40)
    assert (host[1].gradient_count > 0).any()
    assert_as_reference(device, there, host)


def new_anchors(rng: np.random.Generator, sizes: list[int], among: int) -> growth.NewAnchors:
    return growth.NewAnchors(
        rng.normal(size=(len(sizes), 3)).astype(np.float32),
        rng.normal(size=len(sizes)).astype(np.float32),
        np.cumsum([0, *sizes]).astype(np.int32),
        rng.integers(0, among, sum(sizes)).astype(np.int32),
    )


@pytest.mark.parametrize("count", [3, 200])
def test_new_anchors_come_last(device, rng, count):
    """Also if all memory is taken, and again if there is room after the first time."""
    host = host_arrays(rng, count)
    anchors = host[0].map(device.upload)
    for sizes in ([1, 4, 2], [3], [1] * 150):
        new = new_anchors(rng, sizes, len(host[0]))
        anchors = growth.append(device, anchors, new)
        features = reference.features(host[0].feature, new.first, new.parents)
        added = AnchorSet(
            new.position,
            np.zeros((len(sizes), K_OFFSETS, 3), np.float32),
            features.astype(np.float32),
            np.repeat(new.edge[:, None], 6, axis=1),
        )
        both = zip(host[0].items(), added.items(), strict=True)
        host = AnchorSet(*(np.concatenate([a, b]) for (_, a), (_, b) in both)), host[1]
        for (name, array), (_, wanted) in zip(anchors.items(), host[0].items(), strict=True):
            np.testing.assert_array_equal(device.download(array), wanted, err_msg=name)


@pytest.mark.parametrize("dtype", [np.float32, np.int32])
@pytest.mark.parametrize("shape", [(40,), (40, 6), (40, 10, 3)])
def test_rows_that_are_taken(device, rng, dtype, shape):
    array = rng.integers(-99, 99, shape).astype(dtype)
    rows = np.array([0, 3, 4, 39], np.int32)
    taken = growth.take(device, device.upload(array), device.upload(rows))
    assert taken.dtype == dtype
    np.testing.assert_array_equal(device.download(taken), array[rows])


def test_wrong_arguments_are_refused(device, rng):
    host = host_arrays(rng, 20)
    anchors, statistics = uploaded(device, host)
    with pytest.raises(ValueError, match="slots: must be"):
        growth.places(device, anchors, np.array([200]))
    new = new_anchors(rng, [1, 2], 20)
    wrong = growth.NewAnchors(new.position, new.edge, new.first + np.int32(1), new.parents)
    with pytest.raises(ValueError, match="first: must rise"):
        growth.append(device, anchors, wrong)
    with pytest.raises(ValueError, match="parents"):
        growth.append(device, anchors, new_anchors(rng, [300], 2000))
    few = device.zeros((K_OFFSETS - 1, 64))
    visible = device.zeros((5,), np.int32)
    with pytest.raises(ValueError, match="output"):
        growth.hide_undrawn(device, anchors, statistics, visible, few)
    with pytest.raises(TypeError, match="32 bits"):
        growth.take(device, device.zeros((4, 2), np.float64), visible)
