"""The tables of docs/reference/rasterization.md name what the functions have, and refuse."""

import re
from inspect import signature
from pathlib import Path

import pytest

import clgs
from clgs.render.splat_arguments import REFUSED, REFUSED_LATER
from tests.render.splat_scene import scene

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "rasterization.md"
OURS = ("device", "alpha_max", "options")


def table(head):
    """The cells behind the first by each name that the first cell of a row has."""
    lines = PAGE.read_text().split(f"| {head} |")[1].splitlines()[2:]
    rows = {}
    for line in lines[: lines.index("")]:
        first, *cells = line.strip("|").split("|")
        for name in re.findall(r"`(\w+)`", first):
            assert name not in rows
            rows[name] = [cell.strip() for cell in cells]
    return rows


def test_arguments():
    rows, own = table("argument"), signature(clgs.rasterization).parameters
    assert set(rows) == {*own, *REFUSED_LATER} - {*OURS, "later"}
    assert set(table("ours alone")) == set(OURS)
    assert {name for name, cells in rows.items() if cells[0].startswith("refused")} == set(REFUSED)
    added = {name for name, cells in rows.items() if cells[0] == "not there"}
    assert added == set(REFUSED_LATER)
    assert all(rows[name][1].startswith("refused") for name in (*REFUSED, *REFUSED_LATER))
    for cells in rows.values():
        for cell in cells:
            assert re.match("same|differs|refused|accepted|not there|lidar is refused", cell), cell


def test_arguments_are_those_of_gsplat():
    """The installed gsplat has the same names, in the same order, with the same defaults."""
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
    theirs, own = (signature(one).parameters for one in (gsplat.rasterization, clgs.rasterization))
    rows = table("argument")
    assert set(theirs) <= set(rows)
    if gsplat.__version__ != "1.5.3":
        pytest.skip(f"gsplat is {gsplat.__version__}: order and defaults are those of 1.5.3")
    assert list(theirs) == [name for name in own if name not in (*OURS, "later")]
    for name, one in theirs.items():
        if name != "rolling_shutter":  # an enumeration of gsplat's
            assert own[name].default == one.default, name


def test_results_and_gradients(open_device, rng):
    device = open_device("cpu")
    image, _, meta = clgs.rasterization(**scene(rng), device=device)
    assert set(table("result")) == {*meta, "colors", "alphas", "render_extra_signals", "normals"}
    made = meta["record"].backward(image)
    assert set(table("gradient by")) == {*made, "covars", "Ks", "rays"}


def test_functions():
    torch = pytest.importorskip(
        "clgs.torch", reason="PyTorch is not installed", exc_type=ImportError
    )
    assert all(callable(getattr(torch, name)) for name in table("function"))
