"""Decoding in one against the stages mlp, neural and project, and the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.ops import mlp, neural, project, project_anchors, scan
from clgs.options import DEFAULT, Skips
from clgs.reference import project_anchors as reference
from clgs.scene.anchors import FIELDS
from tests.compare import assert_close, relative_l2
from tests.ops.cases.mlp import anchors, decided, mlp_inputs, packed_camera, some

PROJECTED = ("mean2d", "whitening", "depth", "extent")
LIGHT = ("color", "opacity")


def case(rng, count):
    """Arrays of ``count`` anchors, and weights."""
    return anchors(rng, count) | {
        "offset": rng.normal(size=(count, 10, 3)).astype(np.float32),
        "scaling": rng.uniform(-6, -1, (count, 6)).astype(np.float32),
    }


def in_one(device, values, visible, options=DEFAULT, room=scan.EXACT):
    inputs = mlp_inputs(device, values)
    return project_anchors.forward(device, inputs, device.upload(visible), options, room)


def by_stages(device, values, visible, room=scan.EXACT):
    """What the three stages make, and the anchor of each Gaussian."""
    inputs = mlp_inputs(device, values)
    decoded = mlp.forward(device, inputs, device.upload(visible))
    drawn = neural.forward(device, decoded, inputs.anchors, room)
    found = project.forward(device, drawn, inputs.camera), drawn.total
    return found, device.download(decoded.visible)[device.download(drawn.slot) // 10]


def host(device, found):
    """All that there is of the Gaussians, by name, and how many there are."""
    projected, total = found
    arrays = {name: device.download(getattr(projected, name)) for name in (*PROJECTED, *LIGHT)}
    return arrays | {"total": device.download(total)}


def assert_same(device, found, expected):
    pair = host(device, found), host(device, expected)
    for name in pair[0]:
        assert pair[0][name].tobytes() == pair[1][name].tobytes(), name


@pytest.mark.parametrize("counts", [(0, 5), (33, 100), (700, 900)])
def test_the_bits_are_those_of_the_stages(device, rng, counts):
    values, visible = case(rng, counts[1]), some(rng, *counts)
    found = in_one(device, values, visible)
    assert len(found[0].opacity) > 0 or counts[0] == 0
    assert_same(device, found, by_stages(device, values, visible)[0])


@pytest.mark.parametrize("room", [0, 100, 5000])
def test_the_bits_are_those_of_the_stages_with_a_room(device, rng, room):
    values = case(rng, 400)
    visible = np.append(some(rng, 300, 400), np.full(37, -1, np.int32))
    found = in_one(device, values, visible, room=room)
    assert len(found[0].opacity) == room
    assert_same(device, found, by_stages(device, values, visible, room)[0])


@pytest.mark.slow
@pytest.mark.parametrize("skipped", ["opacity_first", "slots"])
def test_the_bits_are_those_of_all_skips(device, rng, skipped):
    values, visible = case(rng, 400), some(rng, 300, 400)
    options = replace(DEFAULT, skips=replace(Skips(), **{skipped: False}))
    found = in_one(device, values, visible, options)
    assert_same(device, found, in_one(device, values, visible))


def test_anchors_that_are_not_finite_draw_nothing(device, rng):
    values, every = case(rng, 60), np.arange(60, dtype=np.int32)
    values["feature"][7, 3], values["position"][9, 1] = np.nan, np.inf
    expected, anchor = by_stages(device, values, every)
    assert not np.isin([7, 9], anchor).any()
    assert_same(device, in_one(device, values, every), expected)


def test_forward_agrees_with_reference(device, rng):
    values = case(rng, 500)
    visible = decided({name: values[name] for name in ("feature", "position", "weights")})
    found = host(device, in_one(device, values, visible))
    anchor = by_stages(device, values, visible)[1]
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    given = tuple(wide[name] for name in FIELDS)
    expected, *light = reference.forward(given, visible, wide["weights"], packed_camera())
    # slots ascend within an anchor, and anchors in `visible`
    order = np.argsort(anchor, kind="stable")
    assert len(order) == len(expected.depth) > 500
    drawn = expected.extent[:, 0] > 0
    assert np.mean((found["extent"][order, 0] > 0) == drawn) > 0.99
    drawn &= found["extent"][order, 0] > 0
    assert drawn.sum() > 100
    for name, wanted in zip(("color", "opacity"), light, strict=True):
        assert_close(found[name][order], wanted, 1e-5, name)
    for name in PROJECTED:
        actual, wanted = found[name][order][drawn], getattr(expected, name)[drawn]
        # 54 products of order one are summed twice before anything is projected
        assert relative_l2(actual, wanted) <= 1e-5, name


def test_wrong_shapes_are_refused(device, rng):
    values = case(rng, 5) | {"scaling": np.zeros((5, 5), np.float32)}
    with pytest.raises(ValueError, match="scaling"):
        in_one(device, values, some(rng, 2, 5))
