"""The MLP kernels against the float64 reference, on both specialisations."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pyopencl as cl
import pytest

from clgs import constants
from clgs.lab.kernels import drawn_output, drawn_rows
from clgs.lab.savings import MlpWork, mlp_work
from clgs.opencl import programs
from clgs.opencl.programs import literal
from clgs.ops import mlp
from clgs.options import DEFAULT, RenderOptions, Skips
from clgs.reference import mlp as reference
from tests.compare import assert_close, relative_l2
from tests.ops.cases.mlp import (
    anchors,
    decided,
    mlp_inputs,
    packed_camera,
    some,
    with_opacity_bias,
)

EPSILON = 2.0**-24
COUNTS = [0, 1, 33, 1025]


def run_forward(device, values, visible, options=DEFAULT):
    return mlp.forward(device, mlp_inputs(device, values), device.upload(visible), options)


def run_backward(device, values, visible, d_of_anchor, options=DEFAULT, by_weights=True):
    """Downloads of the gradients; d_of_anchor (A, 110) by the anchors' outputs."""
    activations = run_forward(device, values, visible, options)
    columns = device.download(activations.visible)
    d_output = np.full(activations.output.shape, 7, np.float32)
    d_output[:, : len(columns)] = np.where(columns >= 0, d_of_anchor[columns].T, 7)
    inputs, d_output = mlp_inputs(device, values), device.upload(d_output)
    result = mlp.backward(device, inputs, activations, d_output, by_weights)
    return {name: device.download(array) for name, array in vars(result).items()}


def random_gradients(rng, anchors):
    return rng.normal(size=(anchors, 110)).astype(np.float32)


def expected_activations(values, visible):
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    return reference.forward(**wide, visible=visible, camera=packed_camera())


def expected_gradients(values, visible, d_of_anchor):
    wide = {name: value.astype(np.float64) for name, value in values.items()}
    activations = expected_activations(values, visible)
    d_output = np.where(drawn_rows(activations.output), d_of_anchor[visible].T, 0)
    d_output[:10] *= activations.output[:10] > 0
    arguments = (len(d_of_anchor), wide["weights"], d_output.astype(np.float64))
    gradients = reference.backward(activations, *arguments)
    return dict(zip(("d_weights", "d_feature"), gradients, strict=True))


def gradient_terms(values, visible, d_of_anchor):
    """Sums of absolute terms of every gradient: the backward pass of absolute values."""
    forward = expected_activations(values, visible)
    # hidden values with the terms they were summed from; activations at their steepest
    hidden = np.where(forward.hidden > 0, term_sums(values, forward)[0], 0)
    steepest = np.where(np.arange(110)[:, None] < 10, 0, 0.5) + 0 * forward.output
    absolute = reference.Activations(np.abs(forward.input), hidden, steepest, visible)
    weights = np.abs(values["weights"].astype(np.float64))
    arguments = (len(d_of_anchor), weights, np.abs(d_of_anchor[visible].T))
    gradients = reference.backward(absolute, *arguments)
    return dict(zip(("d_weights", "d_feature"), gradients, strict=True))


def term_sums(values, activations):
    """Sum of absolute terms of every hidden and output sum: what the rounding scales with."""
    hidden, output = [], []
    for head in reference.heads(values["weights"].astype(np.float64)):
        terms = np.abs(head.hidden_weight) @ np.abs(activations.input[:-1])
        hidden.append(terms + np.abs(head.hidden_bias[:, None]))
        terms = np.abs(head.output_weight) @ (hidden[-1] + activations.hidden[head.units])
        output.append(terms + np.abs(head.output_bias[:, None]))
    return np.concatenate(hidden), np.concatenate(output)


@pytest.mark.parametrize("count", COUNTS)
def test_forward_agrees_with_reference(device, rng, count):
    values = anchors(rng, 3000)
    visible = rng.choice(decided(values), count, replace=False)
    activations = run_forward(device, values, visible)
    columns = device.download(activations.visible)
    for first in range(0, count, mlp.CHUNK):
        chunk = slice(first, first + mlp.CHUNK)
        assert np.array_equal(np.sort(columns[chunk]), np.sort(visible[chunk]))
    output = device.download(activations.output)
    assert output.shape == (110, mlp.padded_size(count))
    assert not output[:10, count:].any(), "nothing is drawn in the padding"
    expected = expected_activations(values, columns)
    rows = drawn_rows(expected.output)
    # 53 and 50 products added in order, see term_sums: the error of each partial sum is at most
    # half an ulp of it, and such errors average out; activations have slopes up to 1 and add two
    # roundings of a value up to 1
    _, terms = term_sums(values, expected)
    limit = 2 * EPSILON * terms + 4 * EPSILON
    assert_close(output[:, :count][rows], expected.output[rows], limit[rows], "output")


def test_without_gradient_by_weights_the_others_are_the_same(device, rng):
    values, visible = anchors(rng, 3000), some(rng, 1025, 3000)
    arguments = device, values, visible, random_gradients(rng, 3000)
    both, alone = run_backward(*arguments), run_backward(*arguments, by_weights=False)
    assert both["d_weights"].any()
    assert not alone["d_weights"].any()
    assert np.array_equal(alone["d_feature"], both["d_feature"])


def test_samples_are_sorted_by_drawn_slots(device, rng):
    values, visible = anchors(rng, 1500), some(rng, 1300, 1500)
    activations = run_forward(device, values, visible)
    drawn = device.download(activations.output)[:10, :1300] > 0
    sequence = np.array([i ^ (i >> 1) for i in range(1024)])
    place = np.argsort(sequence)[(1 << np.arange(10)) @ drawn]
    columns, active = device.download(activations.visible), device.download(activations.active)
    assert len(np.unique(place)) > 100
    for chunk, first in enumerate(range(0, 1300, mlp.CHUNK)):
        part = slice(first, first + mlp.CHUNK)
        order = np.lexsort((columns[part], -place[part]))
        assert np.array_equal(order, np.arange(len(order))), "equal ones stay as they were"
        assert active[chunk] == drawn[:, part].any(axis=0).sum()


@pytest.mark.parametrize("count", COUNTS)
def test_backward_agrees_with_reference(device, rng, count):
    values = anchors(rng, 3000)
    visible = rng.choice(decided(values), count, replace=False)
    d_of_anchor = random_gradients(rng, 3000)
    expected = expected_gradients(values, visible, d_of_anchor)
    terms = gradient_terms(values, visible, d_of_anchor)
    for name, array in run_backward(device, values, visible, d_of_anchor).items():
        assert relative_l2(array, expected[name]) <= 1e-6, name
        # sums of up to 110 x 50 products whose errors average out, and the rounding of activations
        assert_close(array, expected[name], 4 * EPSILON * terms[name] + 1e-30, name)


def test_dealing_out_does_not_change_a_bit(device, rng, monkeypatch):
    values, visible = anchors(rng, 6000), some(rng, 5000, 6000)
    d_of_anchor = random_gradients(rng, 6000)
    whole = run_backward(device, values, visible, d_of_anchor)
    monkeypatch.setattr(mlp, "SLAB", 3)
    monkeypatch.setattr(mlp, "WORKERS", 5)
    parts = run_backward(device, values, visible, d_of_anchor)
    for name, array in whole.items():
        assert np.array_equal(array, parts[name]), name


SKIPS = [
    Skips(opacity_first=first, slots=slots) for first in (False, True) for slots in (False, True)
]


@pytest.mark.slow
@pytest.mark.parametrize("bias", [-9, -0.4, 9])
def test_skips_do_not_change_a_bit(device, rng, bias):
    values, visible = with_opacity_bias(anchors(rng, 1500), bias), some(rng, 1300, 1500)
    d_of_anchor = random_gradients(rng, 1500)
    outputs, gradients, works = [], [], []
    for skips in SKIPS:
        options = RenderOptions(skips=skips)
        activations = run_forward(device, values, visible, options)
        outputs.append(drawn_output(device, activations))
        gradients.append(run_backward(device, values, visible, d_of_anchor, options=options))
        works.append(mlp_work(device, activations))
    assert all(np.array_equal(outputs[0], other) for other in outputs)
    for name, array in gradients[0].items():
        assert all(np.array_equal(array, other[name]) for other in gradients), name
    none, slots, first, both = works
    assert none == MlpWork(1300, 1300, 100 * 1300, 100 * 1300)
    assert (slots.samples, first.samples, first.rows) == (1300, both.samples, 100 * both.samples)
    assert slots.rows == both.rows
    drawn = (outputs[0][:10] > 0).sum()
    assert 10 * drawn <= both.rows <= first.rows <= none.rows
    assert (drawn == 0) == (both.rows == 0), "nothing at all where nothing is drawn"
    assert bias > -1 or both.rows < 0.8 * none.rows


def test_undrawn_slots_have_no_gradient(device, rng):
    values, visible = anchors(rng, 700), some(rng, 600, 700)
    d_of_anchor = random_gradients(rng, 700)
    activations = run_forward(device, values, visible)
    columns = device.download(activations.visible)
    drawn = drawn_output(device, activations)
    rows = drawn_rows(drawn)
    rows[:10] &= drawn[:10] > 0
    other = d_of_anchor.copy()
    other[columns] = np.where(rows.T, d_of_anchor[columns], np.nan)
    expected = run_backward(device, values, visible, d_of_anchor)
    for name, array in run_backward(device, values, visible, other).items():
        assert np.array_equal(array, expected[name]), name


@pytest.mark.parametrize("padding", [1, 1000])
def test_padding_does_not_change_a_bit(device, rng, padding):
    values, visible = anchors(rng, 700), some(rng, 600, 700)
    d_of_anchor = random_gradients(rng, 700)
    padded = np.concatenate([visible, np.full(padding, -1, np.int32)])
    without, activations = (run_forward(device, values, each) for each in (visible, padded))
    columns = device.download(activations.visible)
    assert np.array_equal(columns[:600], device.download(without.visible))
    assert (columns[600:] == -1).all()
    assert not device.download(activations.output)[:10, 600:].any()
    outputs = drawn_output(device, activations)[:, :600]
    assert np.array_equal(outputs, drawn_output(device, without))
    assert mlp_work(device, activations) == mlp_work(device, without)
    expected = run_backward(device, values, visible, d_of_anchor)
    for name, array in run_backward(device, values, padded, d_of_anchor).items():
        assert np.array_equal(array, expected[name]), name


def test_samples_without_anchor_may_lie_anywhere(device, rng):
    """A sample without anchor may come first in a block."""
    values, visible = anchors(rng, 200), some(rng, 200, 200)
    gaps = visible.copy()
    gaps[::8] = -1
    expected, found = (outputs_by_anchor(device, values, each) for each in (visible, gaps))
    for one in gaps[gaps >= 0]:
        assert np.array_equal(found[one], expected[one])


@pytest.mark.parametrize("slot", ["feature", "position"])
@pytest.mark.parametrize("poison", [np.nan, np.inf, 2e15])
def test_poison_stays_in_its_anchor(device, rng, slot, poison):
    values, visible = anchors(rng, 70), some(rng, 65, 70)
    d_of_anchor = random_gradients(rng, 70)
    bad = int(visible[30])
    d_of_anchor[bad] = 0
    clean = outputs_by_anchor(device, values, visible)
    clean_gradients = run_backward(device, values, visible, d_of_anchor)
    values[slot][bad] = poison
    dirty = outputs_by_anchor(device, values, visible)
    assert all(np.array_equal(clean[one], dirty[one]) for one in visible if one != bad)
    if slot == "feature" or not np.isfinite(poison):
        assert np.isnan(dirty[bad][:10]).all(), "not drawn: no comparison with NaN holds"
    # the weights see the other anchors only; they may lie elsewhere
    d_of_anchor[bad] = 5 if np.isnan(dirty[bad][0]) else 0
    terms = gradient_terms(values, visible[visible != bad], d_of_anchor)
    for name, array in run_backward(device, values, visible, d_of_anchor).items():
        limit = 4 * EPSILON * np.nan_to_num(terms[name])
        assert_close(array, clean_gradients[name], limit, name)
        assert not array[bad].any() or name == "d_weights"


@pytest.mark.parametrize("slot", ["feature", "position"])
def test_poison_does_not_reach_the_weights_if_nothing_is_skipped(device, rng, slot):
    """Samples that draw nothing are part of the sums then."""
    options = RenderOptions(skips=Skips(opacity_first=False, slots=False))
    values, visible = anchors(rng, 70), some(rng, 65, 70)
    d_of_anchor = random_gradients(rng, 70)
    bad = int(visible[30])
    values[slot][bad] = np.inf
    terms = gradient_terms(values, visible[visible != bad], d_of_anchor)["d_weights"]
    found = run_backward(device, values, visible, d_of_anchor, options=options)
    without = run_backward(device, values, visible[visible != bad], d_of_anchor, options=options)
    # the others may lie elsewhere
    assert_close(found["d_weights"], without["d_weights"], 4 * EPSILON * terms, "d_weights")
    assert not found["d_feature"][bad].any()


def outputs_by_anchor(device, values, visible):
    activations = run_forward(device, values, visible)
    output = drawn_output(device, activations)
    return dict(zip(device.download(activations.visible).tolist(), output.T, strict=True))


def test_camera_centre_has_no_direction(device, rng):
    values, visible = anchors(rng, 8), np.arange(8, dtype=np.int32)
    values["position"][3] = packed_camera()[23:26]
    values["position"][4] = packed_camera()[23:26] * np.float32(1 + 2e-7)
    activations = run_forward(device, values, visible)
    expected = expected_activations(values, device.download(activations.visible))
    assert np.linalg.norm(expected.input[50:53], axis=0).round(6).tolist().count(0) == 1
    limit = 2 * EPSILON * term_sums(values, expected)[1] + 4 * EPSILON
    output = drawn_output(device, activations)
    rows = drawn_rows(expected.output)
    assert_close(output[rows], expected.output[rows], limit[rows], "output")
    gradients = run_backward(device, values, visible, random_gradients(rng, 8))
    assert all(np.isfinite(array).all() for array in gradients.values())


def test_both_specialisations_decode_the_same(open_device, rng):
    """Rows are summed in one order everywhere; samples are sorted alike."""
    values, visible = anchors(rng, 800), some(rng, 700, 800)
    devices = [open_device(form) for form in ("cpu", "gpu")]
    activations = [run_forward(device, values, visible) for device in devices]
    both = list(zip(devices, activations, strict=True))
    assert np.array_equal(*(device.download(each.visible) for device, each in both))
    assert np.array_equal(*(drawn_output(device, each) for device, each in both))


def test_both_specialisations_go_back_the_same(open_device, rng):
    """Samples are summed in one order everywhere; five batches, the last one not full."""
    values, visible = anchors(rng, 2500), some(rng, 2200, 2500)
    d_of_anchor = random_gradients(rng, 2500)
    cpu, gpu = (run_backward(open_device(n), values, visible, d_of_anchor) for n in ("cpu", "gpu"))
    for name, array in cpu.items():
        assert np.array_equal(array, gpu[name]), name


HASH_SCRIPT = """
import hashlib
import numpy as np
from clgs.opencl.device import Device
from tests.ops.cases.mlp import anchors, some
from tests.ops.test_mlp import run_backward
rng = np.random.default_rng(5)
values, visible = anchors(rng, 4000), some(rng, 3333, 4000)
d_of_anchor = rng.normal(size=(4000, 110)).astype(np.float32)
for _ in range(2):
    result = run_backward(Device(specialisation="cpu"), values, visible, d_of_anchor)
    joined = b"".join(result[name].tobytes() for name in sorted(result))
    print(hashlib.sha256(joined).hexdigest())
"""


@pytest.mark.slow
def test_threads_do_not_change_a_bit():
    hashes = set()
    for threads in ("1", "2"):
        environment = {**os.environ, "POCL_MAX_PTHREAD_COUNT": threads}
        result = subprocess.run(
            [sys.executable, "-c", HASH_SCRIPT],
            env={**environment, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        )
        hashes.update(result.stdout.split())
    assert len(hashes) == 1
    assert len(hashes.pop()) == 64


def test_wrong_shapes_are_refused(device, rng):
    values, visible = anchors(rng, 8), np.arange(8, dtype=np.int32)
    with pytest.raises(ValueError, match="feature"):
        run_forward(device, {**values, "feature": values["feature"][:, :49]}, visible)
    with pytest.raises(ValueError, match="weights"):
        run_forward(device, {**values, "weights": values["weights"][1:]}, visible)
    with pytest.raises(TypeError, match="visible"):
        run_forward(device, values, visible.astype(np.int64))


@pytest.mark.slow
@pytest.mark.parametrize("count", [33, 1025])
def test_sizes_for_few_registers_make_the_same_bits(open_device, rng, monkeypatch, count):
    device, values, visible = open_device("gpu"), anchors(rng, count), np.arange(count)
    d, visible = random_gradients(rng, count), visible.astype(np.int32)
    usual = run_backward(device, values, visible, d)
    monkeypatch.setattr(type(device), "has_few_registers", property(lambda self: True))
    assert mlp.sizes(device).items() >= mlp.FEW_REGISTERS.items()
    for name, found in run_backward(device, values, visible, d).items():
        assert found.tobytes() == usual[name].tobytes(), name


@pytest.mark.parametrize("few", [False, True])
def test_the_kernels_lay_out_what_python_allocates(device, monkeypatch, few):
    """The rows of a batch, and a part of the weight gradient, have the sizes of their buffers."""
    if few and device.specialisation == "cpu":
        pytest.skip("a CPU has no work-groups")
    monkeypatch.setattr(type(device), "has_few_registers", property(lambda self: few))
    file = programs.program_file("mlp/backward", device.specialisation)
    text = programs.read_program(file) + (
        "\n__kernel void sizes(__global int *out) {"
        " out[0] = (int)BATCH_SIZE; out[1] = (int)part_size(); }"
    )
    form = {"USE_LOCAL": int(device.specialisation == "gpu")}
    macros = {**constants.defines(), **form, **mlp.defines(device, DEFAULT)}
    built = cl.Program(device.context, text).build(
        ["-cl-std=CL1.2", *(f"-D{name}={literal(value)}" for name, value in macros.items())]
    )
    found = device.zeros((2,), np.int32)
    cl.Kernel(built, "sizes")(device.queue, (1,), (1,), found.buffer)
    assert device.download(found).tolist() == [mlp._batch_size(device), mlp._part_size(device)]
