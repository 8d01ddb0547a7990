"""Launch sizes that follow the device."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from clgs.opencl.grid import chunk_count


@pytest.mark.parametrize(("units", "wanted"), [(1, 2), (2, 4), (16, 32), (128, 32)])
def test_lists_are_divided_among_the_threads(units, wanted):
    device = SimpleNamespace(cl_device=SimpleNamespace(max_compute_units=units))
    assert chunk_count(device) == wanted
