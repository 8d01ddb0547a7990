"""The densification statistics against the plain reference."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.constants import K_OFFSETS, OUTPUT_DIM
from clgs.ops import density
from clgs.ops.neural import NeuralGaussians
from clgs.reference import density as reference
from tests.compare import assert_close

SIZE = (320, 200)


def view(rng, anchors, visible_count, drawn=0.8):
    """MLP outputs and Gaussians of one view, as the pipeline would leave them."""
    visible = np.sort(rng.choice(anchors, visible_count, replace=False)).astype(np.int32)
    padded = -(-max(visible_count, 1) // 32) * 32
    output = rng.normal(size=(OUTPUT_DIM, padded)).astype(np.float32)
    slot = np.flatnonzero(output[:K_OFFSETS, :visible_count].T.ravel() > 0).astype(np.int32)
    extent = rng.uniform(1, 9, (len(slot), 2)) * (rng.random((len(slot), 1)) < drawn)
    d_mean2d = rng.normal(0, 1e-5, (len(slot), 2))
    return output, visible, slot, extent.astype(np.float32), d_mean2d.astype(np.float32)


def add(device, statistics, output, visible, slot, extent, d_mean2d, stop=None):
    arrays = map(device.upload, (output, visible, slot, extent, d_mean2d))
    density.accumulate(device, statistics, density.SeenView(*arrays, SIZE), stop)


def test_agrees_with_reference(device, rng):
    statistics, expected = density.zeros(device, 700), reference.zeros(700)
    for count in (700, 0, 1, 333):
        values = view(rng, 700, count)
        add(device, statistics, *values)
        output, visible, slot, extent, d_mean2d = values
        wide = (slot, extent, d_mean2d.astype(np.float64))
        reference.accumulate(expected, output.astype(np.float64), visible, wide, SIZE)
    assert np.array_equal(device.download(statistics.visits), expected.visits)
    assert np.array_equal(device.download(statistics.gradient_count), expected.gradient_count)
    # ten positive terms and three views; two products, a root and three views
    limit = 16 * 2.0**-24
    assert_close(
        device.download(statistics.opacity_sum),
        expected.opacity_sum,
        limit * expected.opacity_sum,
        "opacity_sum",
    )
    assert_close(
        device.download(statistics.gradient_sum),
        expected.gradient_sum,
        limit * expected.gradient_sum,
        "gradient_sum",
    )


def test_nothing_drawn_leaves_gradients(device, rng):
    statistics = density.zeros(device, 50)
    add(device, statistics, *view(rng, 50, 50, drawn=0.0))
    assert not device.download(statistics.gradient_count).any()
    assert not device.download(statistics.gradient_sum).any()
    assert device.download(statistics.visits).all()


def test_padding_changes_no_bit(device, rng):
    statistics, padded = density.zeros(device, 60), density.zeros(device, 60)
    output, visible, slot, extent, d_mean2d = view(rng, 60, 40)
    add(device, statistics, output, visible, slot, extent, d_mean2d)
    add(
        device,
        padded,
        output,
        np.append(visible, np.full(9, -1, np.int32)),
        np.append(slot, np.full(70, -1, np.int32)),
        np.append(extent, np.zeros((70, 2), np.float32), axis=0),
        np.append(d_mean2d, np.ones((70, 2), np.float32), axis=0),
    )
    for name in ("opacity_sum", "visits", "gradient_sum", "gradient_count"):
        found, plain = (device.download(getattr(one, name)) for one in (padded, statistics))
        assert np.array_equal(found, plain), name


def test_a_stop_flag_stops_everything(device, rng):
    statistics = density.zeros(device, 50)
    add(device, statistics, *view(rng, 50, 50), stop=device.upload(np.array([2], np.int32)))
    for name in ("opacity_sum", "visits", "gradient_sum", "gradient_count"):
        assert not device.download(getattr(statistics, name)).any(), name


def test_wrong_shapes_are_refused(device, rng):
    statistics = density.zeros(device, 50)
    output, visible, slot, extent, d_mean2d = view(rng, 50, 40)
    with pytest.raises(ValueError, match="output"):
        add(device, statistics, output[:, :32], visible, slot, extent, d_mean2d)
    with pytest.raises(ValueError, match="extent"):
        add(device, statistics, output, visible, slot, extent[1:], d_mean2d)
    with pytest.raises(TypeError, match="slot"):
        add(device, statistics, output, visible, slot.astype(np.int64), extent, d_mean2d)


def signed_view(rng, anchors, visible_count):
    """Visible anchors, slots in ascending order, opacities and derivatives by them, one view."""
    visible = rng.choice(anchors, visible_count, replace=False).astype(np.int32)
    slot = np.flatnonzero(rng.random(visible_count * K_OFFSETS) < 0.3).astype(np.int32)
    opacity, d_opacity = rng.random(len(slot)), rng.normal(0, 30, len(slot))
    return visible, slot, opacity.astype(np.float32), d_opacity.astype(np.float32)


def add_importance(device, importance, visible, slot, opacity, d_opacity):
    first = np.searchsorted(slot, np.arange(len(visible) + 1) * K_OFFSETS).astype(np.int32)
    unread = device.zeros((0,))
    uploaded = [device.upload(each) for each in (opacity, slot, first)]
    gaussians = NeuralGaussians(*[unread] * 4, *uploaded, drawn=unread, total=unread)
    values = device.upload(d_opacity)
    density.add_importance(device, importance, device.upload(visible), gaussians, values)


def test_importance_agrees_with_reference(device, rng):
    found, expected, seen = density.no_importance(device, 700), np.zeros(700), np.zeros(700, bool)
    size = np.zeros(700)
    for count in (700, 0, 1, 333):
        visible, slot, opacity, d_opacity = signed_view(rng, 700, count)
        add_importance(device, found, visible, slot, opacity, d_opacity)
        wide = opacity.astype(np.float64), d_opacity.astype(np.float64)
        expected += reference.importance(visible, slot, *wide, 700)
        size += reference.importance(visible, slot, wide[0], np.abs(wide[1]), 700)
        seen[visible] = True
    # ten products, a square and three views, of a sum whose terms may cancel
    limit = 16 * 2.0**-24 * size
    assert_close(device.download(found.total), expected, limit, "total")
    assert np.array_equal(device.download(found.seen), seen)


def test_importance_knows_of_anchors_without_gaussians_and_of_padding(device, rng):
    visible, slot, opacity, d_opacity = signed_view(rng, 60, 40)
    plain, padded = density.no_importance(device, 60), density.no_importance(device, 60)
    add_importance(device, plain, visible, slot, opacity, d_opacity)
    add_importance(
        device,
        padded,
        np.append(visible, np.full(9, -1, np.int32)),
        np.append(slot, np.full(70, 2**30, np.int32)),
        np.append(opacity, np.ones(70, np.float32)),
        np.append(d_opacity, np.ones(70, np.float32)),
    )
    for name in ("total", "seen"):
        found, wanted = (device.download(getattr(one, name)) for one in (padded, plain))
        assert np.array_equal(found, wanted), name
    empty = density.no_importance(device, 60)
    nothing = np.zeros(0, np.float32)
    add_importance(device, empty, visible, np.zeros(0, np.int32), nothing, nothing)
    assert not device.download(empty.total).any()
    assert np.flatnonzero(device.download(empty.seen)).tolist() == sorted(visible)


@pytest.mark.parametrize("shape", [(1,), (7, 6), (33, 10, 3), (1000, 50), (0, 6)])
def test_curvature_adds_squares(device, rng, shape):
    sums, expected = device.zeros(shape), np.zeros(shape)
    for _ in range(3):
        derivative = rng.normal(size=shape).astype(np.float32)
        density.add_curvature(device, sums, device.upload(derivative))
        expected += np.square(derivative.astype(np.float64))
    assert_close(device.download(sums), expected, 4 * 2.0**-24 * expected, "curvature")


def test_wrong_shapes_of_importance_and_curvature_are_refused(device, rng):
    importance = density.no_importance(device, 50)
    visible, slot, opacity, d_opacity = signed_view(rng, 50, 40)
    with pytest.raises(ValueError, match="d_opacity"):
        add_importance(device, importance, visible, slot, opacity, d_opacity[1:])
    with pytest.raises(TypeError, match="visible"):
        add_importance(device, importance, visible.astype(np.int64), slot, opacity, d_opacity)
    with pytest.raises(ValueError, match="derivative"):
        density.add_curvature(device, device.zeros((5, 6)), device.zeros((6, 5)))
