"""Plans of `clgs run` fit the time, and take what the user chose."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from clgs.cli.options import duration
from clgs.workflow.runs.plan import (
    CLIP_SHARE,
    CLIPS,
    ENOUGH_STEPS,
    FEATURES_PER_PIXEL,
    FIXED_SECONDS,
    FRAMES,
    KEPT,
    LATER_SECONDS,
    LATER_STEPS,
    LEAST_STEPS,
    MOST_STEPS,
    POSES_SHARE,
    PRODUCT_SECONDS,
    ROUNDS,
    SHORT_STEPS,
    SIZES,
    Photos,
    Presentation,
    StepSpeed,
    TriedPhotos,
    fit_speed,
    frames_within,
    make_plan,
    must_hurry,
    plan_clip,
    poses_time,
)
from clgs.workflow.runs.record import find_input, in_words
from tests.data.folders import save_json, write_blender, write_colmap, write_transforms

PHOTOS = Photos(50, 4000, 3000)
SPEED = StepSpeed(0.02, 2e-7)


@given(st.floats(20, 1e5), st.floats(0, 1e3))
def test_plan_fits_the_time_or_is_the_least(seconds, preparing):
    plan = make_plan(PHOTOS, SPEED, preparing, seconds)
    least = plan.max_size == SIZES[-1] and plan.steps == LEAST_STEPS
    assert least or plan.seconds <= seconds * 1.001
    assert LEAST_STEPS <= plan.steps <= MOST_STEPS


@given(st.floats(20, 1e5), st.floats(1, 10))
def test_more_time_is_never_spent_on_smaller_pictures(seconds, times):
    plans = [make_plan(PHOTOS, SPEED, 0.0, one) for one in (seconds, times * seconds)]
    assert plans[0].max_size <= plans[1].max_size
    if plans[0].max_size == plans[1].max_size:
        assert plans[0].steps <= plans[1].steps


def step_of_short_run(width):
    """Seconds of a step, a third of which are on photos of half the size."""
    pixels = PHOTOS.at(width)
    return ROUNDS * (0.35 * SPEED.step(pixels // 4) + 0.65 * SPEED.step(pixels))


def test_largest_pictures_that_leave_enough_steps():
    plan = make_plan(PHOTOS, SPEED, 0.0, 300.0)
    larger = SIZES[SIZES.index(plan.max_size) - 1]
    assert plan.steps >= ENOUGH_STEPS
    later = LATER_SECONDS + LATER_STEPS * SPEED.step(PHOTOS.at(larger)) + plan.clip.seconds
    assert (300 - later) / step_of_short_run(larger) < ENOUGH_STEPS


def test_short_runs_on_large_photos_begin_coarse():
    plan = make_plan(PHOTOS, SPEED, 0.0, 300.0, max_size=800)
    assert plan.coarse
    assert LEAST_STEPS < plan.steps < SHORT_STEPS
    assert plan.train_seconds == pytest.approx(plan.steps * step_of_short_run(800))
    assert not make_plan(PHOTOS, SPEED, 0.0, 300.0, max_size=240).coarse
    assert not make_plan(PHOTOS, SPEED, 0.0, 3000.0, max_size=800).coarse
    assert not make_plan(replace(PHOTOS, synthetic=True), SPEED, 0.0, 300.0, max_size=800).coarse
    chosen = [make_plan(PHOTOS, SPEED, 0.0, 300.0, steps, 800) for steps in (1899, 1900)]
    assert [one.coarse for one in chosen] == [True, False]


def test_what_the_user_chose_stays():
    plan = make_plan(PHOTOS, SPEED, 0.0, 60.0, steps=7000, max_size=1234)
    assert (plan.steps, plan.max_size) == (7000, 1234)
    assert make_plan(PHOTOS, SPEED, 0.0, 60.0, max_size=1600).max_size == 1600
    assert make_plan(PHOTOS, SPEED, 0.0, 600.0, steps=1000).steps == 1000


def test_small_photos_are_not_enlarged():
    small = replace(PHOTOS, width=200, height=100)
    assert make_plan(small, SPEED, 0.0, 1e4).max_size == 200
    assert small.at(1600) == 200 * 100


def test_speed_is_the_line_through_two_pictures():
    found = fit_speed(*((pixels, SPEED.step(pixels)) for pixels in (100**2, 300**2)))
    assert found.fixed == pytest.approx(SPEED.fixed)
    assert found.pixel == pytest.approx(SPEED.pixel)


@pytest.mark.parametrize("pixels", [90_000, 10_000])
def test_noise_never_gives_a_speed_below_zero(pixels):
    found = fit_speed((10_000, 0.01), (pixels, 0.003))
    assert found.pixel == 0
    assert found.fixed == 0.01


def test_more_photos_take_longer_to_pose_and_more_cores_less():
    few, more, many = (replace(PHOTOS, count=count) for count in (50, 100, 1000))
    assert poses_time(few, 2, True).seconds < poses_time(more, 2, True).seconds
    assert poses_time(more, 2, False).seconds < poses_time(many, 2, False).seconds
    assert poses_time(few, 8, False).seconds < poses_time(few, 2, False).seconds


def test_more_pixels_take_longer_to_pose_up_to_those_that_are_searched():
    sizes = [(400, 300), (1600, 1200), (3200, 2400), (6400, 4800)]
    seconds = [poses_time(Photos(50, *size), 2, False).seconds for size in sizes]
    # Photos are searched at twice their size, up to 3,200 pixels.
    assert seconds[0] < seconds[1] == seconds[2] == seconds[3]
    assert poses_time(Photos(50, 1700, 1275), 2, False).seconds == pytest.approx(seconds[1])


def test_a_trial_tells_of_features_and_of_the_machine():
    photos = Photos(60, 800, 600)
    usual = poses_time(photos, 2, False)
    found = FEATURES_PER_PIXEL * 1600 * 1200  # photos are searched at twice their size
    search = 2 * usual.features / 60 / KEPT
    tried = [
        replace(photos, trial=TriedPhotos(*one))
        for one in (
            (found, search, PRODUCT_SECONDS),  # as usual
            (found, 3 * search, 3 * PRODUCT_SECONDS),  # on a slow machine
            (found / 10, search, PRODUCT_SECONDS),  # little to see
            (found, search, PRODUCT_SECONDS, 0.0),  # each photo shows another place
        )
    ]
    same, slow, plain, apart = (poses_time(one, 2, False) for one in tried)
    assert same.seconds == pytest.approx(usual.seconds)
    assert slow.seconds == pytest.approx(3 * (usual.seconds - FIXED_SECONDS) + FIXED_SECONDS)
    assert plain.features == pytest.approx(usual.features)
    assert plain.matches < usual.matches / 2
    assert apart.matches < usual.matches / 2
    assert apart.other < usual.other


def test_poses_are_tested_if_there_is_time():
    assert must_hurry(PHOTOS, 2, 200.0)
    assert not must_hurry(PHOTOS, 2, 3600.0)
    assert not must_hurry(replace(PHOTOS, count=11), 2, 300.0)
    busy = TriedPhotos(8192, 60.0, 1e-6)  # the same command finds the same poses
    assert not must_hurry(replace(PHOTOS, trial=busy), 2, 3600.0)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("5m", 300), ("1.5h", 5400), (" 2M ", 120)]
)
def test_times_are_read(text, seconds):
    assert duration(text) == seconds


@pytest.mark.parametrize("text", ["", "0s", "-1m", "5 x", "nan", "9" * 20])
def test_no_times_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="is not a time such as"):
        duration(text)


def test_times_are_shown_in_fitting_units():
    assert [in_words(s) for s in (45, 150, 7200)] == ["45 s", "2.5 min", "2.0 h"]


@given(st.floats(20, 1e5), st.integers(1, 64))
def test_frames_leave_time_for_the_rest(seconds, cores):
    count = frames_within(PHOTOS, cores, seconds)
    share = POSES_SHARE * seconds

    def taken(frames):
        return poses_time(replace(PHOTOS, count=frames), cores, quick=True).seconds

    assert count == FRAMES[-1] or taken(count) <= share
    assert all(taken(n) > share for n in FRAMES if n > count)


@given(st.floats(20, 1e5), st.integers(2, 8000), st.integers(2, 8000))
def test_a_clip_is_slow_and_large_and_leaves_time_for_the_rest(seconds, width, height):
    plan = plan_clip(Photos(9, width, height), SPEED, seconds, Presentation())
    assert 8 <= plan.frames / plan.fps <= 12
    assert plan.width % 2 == plan.height % 2 == 0
    side = min(plan.width, plan.height)
    assert side >= min(720, min(width, height) - 1) or plan.height * plan.width <= width * height
    least = plan.fps == CLIPS[-1][1]
    assert least or plan.seconds <= CLIP_SHARE * seconds
    assert plan.fps == 12 or side >= min(720, min(width, height) - 1)


def test_what_is_chosen_of_a_clip_stays():
    chosen = Presentation(path="spiral", seconds=3, size=(64, 48))
    plan = plan_clip(PHOTOS, SPEED, 600.0, chosen)
    assert (plan.path, plan.frames, plan.width, plan.height) == ("spiral", 90, 64, 48)
    assert plan_clip(PHOTOS, SPEED, 600.0, Presentation(path="none")).seconds == 0
    assert make_plan(PHOTOS, SPEED, 0.0, 3600.0).clip.height == 1080


def test_usual_photos_are_tried(tmp_path):
    for number, size in enumerate(((8, 6), *[(64, 48)] * 9, (6, 8), (90, 80))):
        color = (20 * number, 0, 0)  # no copies
        Image.new("RGB", size, color).save(tmp_path / f"{number:02}.png")
    found = find_input(tmp_path)
    assert (found.photos.width, found.photos.height, found.largest) == (64, 48, 90)
    assert [path.stem for path in found.tried] == ["01", "03", "05", "07"]
    digest = found.digest
    (tmp_path / "masks").mkdir()
    Image.new("L", (64, 48), 255).save(tmp_path / "masks" / "01.png")
    assert find_input(tmp_path).digest != digest


def test_points_are_planned_for_only_where_there_are_none(tmp_path):
    document = write_transforms(tmp_path / "bare", 6)
    assert find_input(tmp_path / "bare").pointless
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    trimesh.PointCloud(points).export(tmp_path / "bare" / "sparse_pc.ply")
    assert find_input(tmp_path / "bare").pointless  # the file is not named
    save_json(tmp_path / "bare", document | {"ply_file_path": "sparse_pc.ply"})
    assert find_input(tmp_path / "bare").complete
    for write in (write_blender, write_colmap):  # begin with random points, or have their own
        write(tmp_path / write.__name__)
        assert find_input(tmp_path / write.__name__).complete
