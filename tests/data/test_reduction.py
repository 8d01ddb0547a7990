"""Wide photos are reduced unless a number of times is asked for; cameras fit what is seen."""

import pytest

from clgs.data.dataset import load_dataset
from clgs.data.reduction import Reduction
from clgs.errors import DataError
from tests.data.folders import write_transforms

SIZE = (1700, 20)


@pytest.mark.parametrize(
    ("reduction", "given", "seen"),
    [
        (Reduction(), (1601, 1000), (1600, 999)),
        (Reduction(), (1600, 4000), (1600, 4000)),
        (Reduction(), (5187, 3361), (1600, 1037)),
        (Reduction(), (4000, 1), (1600, 1)),
        (Reduction(0, 0), (5187, 3361), (5187, 3361)),
        (Reduction(1), (5187, 3361), (5187, 3361)),
        (Reduction(4, 100), (5187, 3361), (1297, 840)),
        (Reduction(0, 100), (5187, 3361), (100, 65)),
    ],
)
def test_sizes(reduction, given, seen):
    assert reduction.size(*given) == seen


def test_wide_photos_are_reduced_by_default(tmp_path):
    write_transforms(tmp_path, 2, SIZE, cx=800.0)
    whole, default = (
        load_dataset(tmp_path, load_images=False, **size).train[0]
        for size in ({"downscale": 1}, {})
    )
    assert (whole.camera.width, whole.camera.height) == SIZE
    assert (default.camera.width, default.camera.height) == (1600, 19)
    assert default.camera.fx == pytest.approx(whole.camera.fx * 1600 / 1700)
    assert default.camera.cx == pytest.approx(whole.camera.cx * 1600 / 1700)
    assert default.camera.cy == pytest.approx(whole.camera.cy * 19 / 20)
    pixels = default.photo.pixels().color
    assert pixels.shape == (19, 1600, 3)
    assert abs(pixels.mean() - whole.photo.pixels().color.mean()) <= 0.5


@pytest.mark.parametrize("times", [1.5, -1])
def test_a_number_of_times_is_at_least_one(tmp_path, times):
    write_transforms(tmp_path, 2)
    with pytest.raises(DataError, match="give a whole number of at least 1"):
        load_dataset(tmp_path, downscale=times)
