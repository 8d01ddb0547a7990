"""What the work-precision figures are made of."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.lab.bench.accuracy_points import (
    FINE,
    GradientError,
    ImageError,
    Point,
    SceneFigures,
    Times,
    accuracy_settings,
    against_parity,
    element_error,
    image_error,
)
from clgs.options import PRESETS


def point(label, milliseconds, error, sweep="preset"):
    times = Times(milliseconds, milliseconds, milliseconds)
    image = ImageError(error / 2, error, 50.0)
    return Point(sweep, label, times, image, image, times, GradientError({"d_offset": 1e-3}, {}))


@pytest.fixture
def figures():
    points = [point("exact", 30.0, 0.1), point("parity", 20.0, 4.0), point("fast", 10.0, 1.5)]
    return SceneFigures("made up", 10, 100, 200, (64, 48), points)


def test_settings_are_presets_and_one_knob_a_sweep():
    settings = accuracy_settings()
    assert {one.label for one in settings if one.sweep == "preset"} == set(PRESETS)
    for one in settings:
        if one.sweep != "preset":
            changed = [
                name
                for name in (field.name for field in fields(FINE))
                if getattr(one.accuracy, name) != getattr(FINE, name)
            ]
            assert set(changed) <= {"inclusive_stop", "transmittance_stop"} or len(changed) == 1
    labels = [(one.sweep, one.label) for one in settings]
    assert len(set(labels)) == len(labels)
    some = accuracy_settings(["exp2 degree"])
    assert {one.sweep for one in some} == {"preset", "exp2 degree"}
    with pytest.raises(UsageError, match="alpha cut"):
        accuracy_settings(["exp2"])


def test_image_error_is_in_levels():
    reference = np.zeros((3, 10, 10))
    image = np.full((3, 10, 10), 1 / 255, np.float32)
    found = image_error(image, reference)
    assert found.p999 == found.largest == pytest.approx(1.0)
    assert found.psnr == pytest.approx(20 * np.log10(255))
    assert image_error(reference.astype(np.float32), reference).psnr == np.inf
    image[0, 0, 0] = np.nan
    assert np.isnan(image_error(image, reference).largest)


def test_element_error_ignores_what_neither_touches():
    wanted = np.concatenate([np.zeros(10_000), np.ones(100)])
    assert element_error((1.5 * wanted).astype(np.float32), wanted) == pytest.approx(0.5)
    assert element_error(np.zeros(10_100, np.float32), wanted) == 1.0
    assert element_error(np.zeros(5, np.float32), np.zeros(5)) == 0.0


def test_presets_are_compared_with_parity(figures):
    assert against_parity(figures)["fast"] == {"forward": 2.0, "both": 2.0, "largest": 1.5}


@pytest.mark.slow
def test_the_plot_is_the_same_file_each_time(figures, tmp_path):
    pytest.importorskip("matplotlib")
    from clgs.lab.bench.accuracy import plot_accuracy

    small = replace(figures.points[0], label="preview", both=None, gradient=None, stopped=None)
    subject = replace(figures, points=[*figures.points, small, point("1/255", 5.0, 0.0, "cut")])
    texts = []
    for name in ("a.svg", "b.svg"):
        plot_accuracy(tmp_path / name, [subject, figures], "a title")
        texts.append((tmp_path / name).read_text())
    assert texts[0] == texts[1]
    for word in ("made up: 100 Gaussians", "parity", "forward, ms", "a title"):
        assert word in texts[0]
