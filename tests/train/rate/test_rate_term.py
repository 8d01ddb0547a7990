"""The price of bytes in the gradient: its size, and its kept tables; bits of integers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clgs.opencl.device import Device
from clgs.reference import rate as reference
from clgs.render.frame import SceneGradients
from clgs.scene.anchors import AnchorSet, QuantizationScales, quantize
from clgs.scene.mlps import init_mlps
from clgs.train.config import TrainConfig
from clgs.train.config.size_settings import MLP_BYTES
from clgs.train.rate.rate_term import (
    CLASSES,
    PUSH,
    RateTerm,
    activity_classes,
    class_bits,
    coded_bits,
    entropy_bits,
    estimated_bytes,
)
from clgs.train.state.run_state import ANCHOR_GROUPS, Parameters, RateState, new_parameters


def test_equal_integers_take_no_bits():
    assert entropy_bits(np.full((50, 3, 2), -7)) == 0.0
    assert entropy_bits(np.zeros((0, 4), np.int32)) == 0.0


def test_known_frequencies():
    fair = np.array([[0, 5], [1, 5], [0, 6], [1, 5]])
    assert entropy_bits(fair) == pytest.approx(4 + 4 * 0.8112781244591328)


@pytest.mark.parametrize("times", [1, 10**8], ids=["near", "far apart"])
def test_bits_are_those_of_frequencies_in_random_integers(rng, times):
    integers = times * rng.integers(-3, 4, (40, 5)).astype(np.int32)
    wanted = 0.0
    for channel in integers.T.tolist():
        for value in channel:
            wanted -= np.log2(channel.count(value) / len(channel))
    assert entropy_bits(integers) == pytest.approx(wanted, rel=1e-12)


def test_classes_hold_equally_many_anchors_by_size(rng):
    integers = rng.integers(-50, 51, (1600, 6))
    classes = activity_classes(integers)
    assert np.bincount(classes, minlength=CLASSES).min() >= 80
    size = np.abs(integers).mean(axis=1)
    for one in range(1, CLASSES):
        assert size[classes < one].max() <= size[classes >= one].min()
    assert activity_classes(np.zeros((0, 6), np.int64)).shape == (0,)


def test_bits_of_classes_are_those_of_their_frequencies(rng):
    integers = rng.integers(-3, 4, (400, 5)).astype(np.int32)
    classes = rng.integers(0, 3, 400)
    wanted = 0.0
    for one in range(3):
        rows = integers[classes == one]
        wanted += entropy_bits(rows)
        for channel in rows.T.tolist():
            wanted += (len(set(channel)) - 1) * 0.5 * np.log2(len(channel))
    assert class_bits(integers, classes) == pytest.approx(wanted, rel=1e-12)
    wide = 10**6 * integers
    assert class_bits(wide, classes) == pytest.approx(entropy_bits(wide), rel=1e-12)


def test_anchors_of_different_size_take_less(rng):
    spread = np.repeat([0.2, 20.0], 1000)[:, None]
    integers = {
        name: np.rint(rng.normal(size=(2000, width)) * spread).astype(np.int32)
        for name, width in (("offset", 30), ("feature", 50), ("scaling", 6))
    }
    found = coded_bits(integers)
    for name, rows in integers.items():
        assert found[name] < 0.95 * entropy_bits(rows)
    alike = {name: rng.integers(-9, 10, rows.shape) for name, rows in integers.items()}
    for name, bits in coded_bits(alike).items():
        assert bits == pytest.approx(entropy_bits(alike[name]), rel=1e-12)


COUNT = 300
SCALES = QuantizationScales(offset=4.0, feature=2.0, scaling=16.0)
CONFIG = TrainConfig(switch_step=0, growth_end=0, growth_start=0, statistics_start=0)


@pytest.fixture
def parameters(device, rng):
    shapes = ((COUNT, 3), (COUNT, 10, 3), (COUNT, 50), (COUNT, 6))
    anchors = AnchorSet(*(rng.laplace(0, 2, shape).astype(np.float32) for shape in shapes))
    return new_parameters(device, anchors, init_mlps(rng))


Priced = tuple[RateTerm, RateState]


def term_of(device: Device, price: float, config: TrainConfig = CONFIG) -> Priced:
    return RateTerm(device, config), RateState(SCALES, price)


def added(device: Device, term: Priced, parameters: Parameters, step: int) -> dict:
    """What a step adds to gradients of zero, and the bits that it reports."""
    tensors = dict(parameters.scene.items())
    zeros = {f"d_{name}": device.zeros(tensors[name].shape) for name in ANCHOR_GROUPS}
    unused = device.zeros((1,))
    gradients = SceneGradients(**zeros, d_weights=unused, d_projected=unused)
    bits = term[0].add(term[1], parameters, gradients, step)
    return {"bits": bits, **{name: device.download(zeros[f"d_{name}"]) for name in ANCHOR_GROUPS}}


def test_the_gradient_is_that_of_the_price_of_all_bits(device, parameters):
    price = 1e-6
    found = added(device, term_of(device, price), parameters, 10)
    total = 0.0
    for name in ANCHOR_GROUPS:
        x, q = device.download(getattr(parameters.scene.anchors, name)), getattr(SCALES, name)
        symbols = reference.symbols(x.reshape(COUNT, -1), q)
        total += reference.forward(symbols)
        wanted = PUSH * price * q * COUNT * reference.backward(symbols)
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(found[name].reshape(COUNT, -1), wanted, atol=2e-4 * scale)
    assert found["bits"] == pytest.approx(total, rel=1e-4)


def test_every_step_gets_it_and_only_some_look_at_all_anchors(device, parameters):
    term = term_of(device, 1e-6)
    assert added(device, term, parameters, 10)["bits"] is not None
    between = added(device, term, parameters, 13)
    assert between["bits"] is None
    assert np.abs(between["feature"]).max() > 0


@pytest.mark.parametrize(("step", "due"), [(0, False), (1, True), (28_500, True), (28_501, False)])
def test_between_the_switch_and_the_rest(device, parameters, step, due):
    found = added(device, term_of(device, 1e-6), parameters, step)
    assert (np.abs(found["feature"]).max() > 0) == due


def test_no_price_no_gradient(device, parameters):
    assert not added(device, term_of(device, 0.0), parameters, 10)["feature"].any()


def test_the_code_weighs_the_bits_of_an_anchor_now_and_then(device, parameters):
    term = term_of(device, 0.0, replace(CONFIG, rate_weight=1e-4))
    assert not added(device, term, parameters, 9)["feature"].any()
    per_anchor = added(device, term, parameters, 10)["feature"]
    x = device.download(parameters.scene.anchors.feature)
    wanted = 1e-4 * 2.0 * reference.backward(reference.symbols(x, 2.0))
    np.testing.assert_allclose(per_anchor, wanted, atol=2e-4 * np.abs(wanted).max())


def test_a_step_done_again_gets_the_table_of_before(device, parameters):
    term = term_of(device, 1e-6)
    added(device, term, parameters, 10)
    first = added(device, term, parameters, 19)
    offset = parameters.scene.anchors.offset
    device.write(offset, 3 * device.download(offset))
    added(device, term, parameters, 20)
    device.write(offset, device.download(offset) / np.float32(3))
    again = added(device, term, parameters, 19)
    np.testing.assert_array_equal(again["scaling"], first["scaling"])
    np.testing.assert_array_equal(again["feature"], first["feature"])


def test_size_that_is_shown_is_that_of_the_integers(device, parameters):
    anchors = quantize(parameters.scene.anchors.map(device.download), SCALES)
    integers = {name: getattr(anchors, name) for name in ANCHOR_GROUPS}
    wanted = MLP_BYTES["float32"] + (sum(coded_bits(integers).values()) + COUNT * 12.0) / 8
    found = estimated_bytes(device, TrainConfig(mlp="float32"), parameters, SCALES)
    assert found == pytest.approx(wanted, abs=1)
