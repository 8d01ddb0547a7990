"""The arithmetic from counts to an estimate of the time on a card."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "scripts" / "gpu_counts"
if not FOLDER.is_dir():
    pytest.skip("needs a checkout", allow_module_level=True)
sys.path.insert(0, str(FOLDER))
try:
    import matching
    import roofline
    import table
    import units
finally:
    sys.path.remove(str(FOLDER))

CARD = roofline.Card("round numbers", 100, 4, 128, 16, 1e9, 1e12, 4e12, 2e-6)
NOTHING = {
    "warp_instructions": 0.0,
    "warp_special": 0.0,
    "lane_operations": 0.0,
    "local_wavefronts": 0.0,
    "global_wavefronts": 0.0,
    "group_sectors_read": 0.0,
    "global_sectors_written": 0.0,
    "compulsory_read": 0.0,
    "compulsory_written": 0.0,
}


@pytest.mark.parametrize(
    ("sums", "binds", "microseconds"),
    [
        ({"warp_instructions": 4e6}, "issue", 10),
        ({"lane_operations": 2 * 128 * 1e6}, "FP32", 10),
        ({"warp_special": 5e5}, "special functions", 10),
        ({"local_wavefronts": 4e5, "global_wavefronts": 6e5}, "shared memory and L1", 10),
        ({"group_sectors_read": 1e6, "global_sectors_written": 2.5e5}, "L2", 10),
        ({"compulsory_read": 4e6, "compulsory_written": 6e6}, "DRAM", 10),
    ],
)
def test_each_limit_by_hand(sums, binds, microseconds):
    found = roofline.bound({**NOTHING, **sums}, 3, groups=1000, group=256, card=CARD)
    assert found.binds == binds
    assert found.limits[binds] == pytest.approx(microseconds)
    assert found.time == pytest.approx(microseconds + 3 * 2)


def test_few_work_groups_leave_processors_idle():
    sums = {**NOTHING, "warp_instructions": 4e6, "local_wavefronts": 1e6}
    many = roofline.bound(sums, 1, groups=1000, group=256, card=CARD)
    few = roofline.bound(sums, 1, groups=10, group=256, card=CARD)
    one = roofline.bound(sums, 1, groups=1, group=32, card=CARD)
    assert few.limits["issue"] == pytest.approx(10 * many.limits["issue"])
    assert few.limits["shared memory and L1"] == pytest.approx(100)
    assert one.limits["issue"] == pytest.approx(4e6 / 1e9 * 1e6)


def test_kernels_one_after_the_other_add_their_largest_limits():
    first = roofline.Bound({"issue": 5.0, "L2": 1.0}, 2.0)
    second = roofline.Bound({"issue": 1.0, "L2": 7.0}, 2.0)
    both = roofline.total([first, second, replace(first, launches=4.0)])
    assert both.limits == {"issue": 10.0, "L2": 7.0}
    assert both.time == 17 + 8
    assert both.binds == "issue"


def work(count, groups, gaussians):
    return units.Work(
        [{"count": count, "items": 256 * groups, "group": 256}], {"Gaussians": gaussians}
    )


def test_counts_grow_with_one_unit_or_two():
    known = [(work(100, 2, 50), {"a": 1000.0}), (work(200, 3, 100), {"a": 2030.0})]
    large = work(4000, 30, 2000)
    assert units.scaled("project_forward", known, large)["a"] == pytest.approx(2030 * 20)
    # 100 x + 4 y = 1000, 200 x + 9 y = 2030
    assert units.scaled("sort_scatter", known, large)["a"] == pytest.approx(4000 * 8.8 + 900 * 30)
    # a share below zero makes no sense: by the first unit alone
    less = [known[0], (known[1][0], {"a": 1900.0})]
    assert units.scaled("sort_scatter", less, large)["a"] == pytest.approx(1900 * 20)


def test_the_longest_name_tells_the_unit():
    assert units.units_of("blend_gather") == ("entries",)
    assert units.units_of("blend_sum") == ("Gaussians",)
    assert units.units_of("new_kernel") == ("launches",)


def state(factor):
    """A step of one kernel in two sizes, and a bench ten times as large as the larger one."""

    def scene(gaussians):
        launch = {"items": 256 * gaussians, "group": 256, "count": gaussians}
        sums = {
            **NOTHING,
            "work_items": 256 * gaussians,
            "warp_instructions": 1000 * gaussians * factor,
            "lane_instructions": 16_000 * gaussians * factor,
            "global_used_read": 320 * gaussians,
            "global_sectors_read": 40 * gaussians,
            "local_wavefronts": 30 * gaussians,
            "local_ideal_wavefronts": 20 * gaussians,
        }
        kernels = {"project forward: project_forward": {"launches": [launch], "sums": sums}}
        return {"kernels": kernels, "units": {"Gaussians": gaussians}}

    bench = scene(1000)
    for each in bench["kernels"].values():
        del each["sums"]
    scenes = {"small": scene(50), "large": scene(100)}
    return {"scenes": scenes, "elements": {}, "benches": {"bench": bench}}


def test_a_row_shows_a_stage():
    row = list(table.by_stage(state(1), "bench"))[2]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells == ["project forward", "1", "1.00", "50%", "25%", "1.50", "4", "launches"]


def test_blocks_of_rows_meet_blocks_of_columns():
    """The work of a search among b blocks of descriptors is 7 b^2 + 3 b here."""
    small, large = 7.0 + 3, 7.0 * 4 + 3 * 2
    assert matching.grown(small, large, 64) == small
    assert matching.grown(small, large, 64 * 32) == 7 * 32**2 + 3 * 32
