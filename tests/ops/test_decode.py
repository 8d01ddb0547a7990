"""Decoding in one against the stages mlp and neural, and against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.ops import decode, mlp, neural
from clgs.options import DEFAULT, Skips
from clgs.reference import decode as reference
from tests.compare import assert_close
from tests.ops.mlp_cases import anchors, decided, packed_camera, some

ANCHORS = ("position", "offset", "feature", "scaling")
FIELDS = ("mean", "scale", "rotation", "color", "opacity", "slot", "drawn")


def case(rng, count):
    """Arrays of ``count`` anchors, and weights."""
    return anchors(rng, count) | {
        "offset": rng.normal(size=(count, 10, 3)).astype(np.float32),
        "scaling": rng.uniform(-6, -1, (count, 6)).astype(np.float32),
    }


def both(device, values, visible, options=DEFAULT, capacity=None):
    """Gaussians of the two ways, and the anchors as they are ordered."""
    arrays = {name: device.upload(value) for name, value in values.items()}
    rest = device.upload(visible), arrays["weights"], device.upload(packed_camera())
    whole = decode.Anchors(*(arrays[name] for name in ANCHORS))
    found = decode.forward(device, whole, *rest, options, capacity)
    separate = mlp.forward(device, arrays["feature"], arrays["position"], *rest, options)
    fields = (separate.output, separate.visible, *(arrays[n] for n in ("position", "offset")))
    expected = neural.forward(device, *fields, arrays["scaling"], capacity)
    return found, expected, device.download(separate.visible)


def assert_same(device, found, expected):
    for name in (*FIELDS, "total"):
        pair = [device.download(getattr(one, name)) for one in (found, expected)]
        assert pair[0].tobytes() == pair[1].tobytes(), name


@pytest.mark.parametrize("counts", [(0, 5), (1, 1), (33, 100), (700, 900), (1500, 1600)])
def test_the_bits_are_those_of_the_stages(device, rng, counts):
    values = case(rng, counts[1])
    found, expected, _ = both(device, values, some(rng, *counts))
    assert len(found) > 0 or counts[0] == 0
    assert_same(device, found, expected)


@pytest.mark.parametrize("capacity", [0, 100, 5000])
def test_the_bits_are_those_of_the_stages_with_a_capacity(device, rng, capacity):
    visible = np.append(some(rng, 300, 400), np.full(37, -1, np.int32))
    found, expected, _ = both(device, case(rng, 400), visible, capacity=capacity)
    assert len(found) == capacity
    assert_same(device, found, expected)


@pytest.mark.parametrize("skipped", ["opacity_first", "slots"])
def test_the_bits_are_those_of_all_skips(device, rng, skipped):
    values, visible = case(rng, 400), some(rng, 300, 400)
    options = replace(DEFAULT, skips=replace(Skips(), **{skipped: False}))
    assert_same(
        device,
        both(device, values, visible, options)[0],
        both(device, values, visible)[0],
    )


def test_anchors_that_are_not_finite_draw_nothing(device, rng):
    values = case(rng, 60)
    values["feature"][7, 3], values["position"][9, 1] = np.nan, np.inf
    every = np.arange(60, dtype=np.int32)
    found, expected, order = both(device, values, every)
    assert_same(device, found, expected)
    drawn = order[device.download(found.slot) // 10]
    assert not np.isin([7, 9], drawn).any()
    assert np.isin(drawn, every).all()


def test_forward_agrees_with_reference(device, rng):
    values = case(rng, 500)
    visible = decided({name: values[name] for name in ("feature", "position", "weights")})
    found, _, order = both(device, values, visible)
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    given = tuple(wide[name] for name in ANCHORS)
    expected = reference.forward(given, visible, wide["weights"], packed_camera())
    slot = device.download(found.slot)
    actual_order = np.argsort(10 * order[slot // 10] + slot % 10)
    expected_order = np.argsort(10 * visible[expected.slot // 10] + expected.slot % 10)
    assert len(actual_order) == len(expected_order) > 500
    for name in ("mean", "scale", "rotation", "color", "opacity"):
        actual = device.download(getattr(found, name))[actual_order]
        wanted = getattr(expected, name)[expected_order]
        # 54 products of order one are summed twice; directions lose what short quaternions lack
        assert_close(actual, wanted, 1e-4 if name == "rotation" else 1e-5, name)


def test_wrong_shapes_are_refused(device, rng):
    values = case(rng, 5) | {"scaling": np.zeros((5, 5), np.float32)}
    with pytest.raises(ValueError, match="scaling"):
        both(device, values, some(rng, 2, 5))
