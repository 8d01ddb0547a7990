"""Exponents and memory of the scaling figures."""

from __future__ import annotations

import pytest

from clgs.lab.bench import scaling
from clgs.lab.bench.scaling import growth
from clgs.opencl.device import Device


def test_exponents_of_powers():
    points = [(n, 3 * n**1.5) for n in (10.0, 20.0, 50.0, 100.0)]
    found = growth(points)
    assert found.exponent == pytest.approx(1.5)
    assert found.exponent_of_larger_half == pytest.approx(1.5)


def test_a_constant_part_shows_in_the_smaller_half():
    found = growth([(n, 100 + n) for n in (1.0, 10.0, 10_000.0, 100_000.0)])
    assert found.exponent < 0.8
    assert found.exponent_of_larger_half == pytest.approx(1, abs=0.01)


@pytest.mark.slow
def test_small_sweeps(tmp_path, monkeypatch):
    monkeypatch.setattr(scaling, "FIXED_GAUSSIANS", 3000)
    monkeypatch.setattr(scaling, "FIXED_SIZE", 64)
    lines = []
    found = scaling.bench_scaling(Device, (3000, 40_000), (64, 512), 3, lines.append)
    assert len(lines) == 8
    first, second = found.by_gaussians
    assert second.gaussians > 10 * first.gaussians
    assert second.peak_bytes > first.peak_bytes > 0
    intersections = [run.intersections for run in found.by_intersections]
    assert intersections == sorted(intersections)
    # a Gaussian has 14 floats of its own, and as many of their gradients; a pixel 9
    assert found.memory.per_gaussian > 4 * 28
    assert found.memory.per_pixel > 4 * 9
    pytest.importorskip("matplotlib")
    scaling.plot_scaling(tmp_path / "s.svg", found, "small")
    assert "exponent" in (tmp_path / "s.svg").read_text()
