"""Cameras that take no picture are refused."""

from __future__ import annotations

import numpy as np
import pytest

from clgs.errors import UsageError
from clgs.scene.camera import Camera

GOOD = {
    "rotation": np.eye(3), "translation": np.zeros(3), "fx": 50.0, "fy": 50.0, "cx": 20.0,
    "cy": 15.0, "width": 40, "height": 30,
}  # fmt: skip


def test_numbers_of_numpy_are_taken():
    camera = Camera(**GOOD | {"width": np.int64(40), "fx": np.float32(50)})
    assert camera.resized(20, 15).fx == 25


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rotation", np.eye(3).tolist(), "rotation: is list, ndarray is needed"),
        ("translation", (0, 0, 1), "translation: is tuple, ndarray is needed"),
        ("rotation", np.array([["a"]]), "rotation: <U1 are no numbers"),
        ("fx", "50", "fx: is str"),
        ("cx", None, "cx: is NoneType"),
    ],
)
def test_a_field_of_another_type_is_named(name, value, said):
    with pytest.raises(TypeError, match=said):
        Camera(**GOOD | {name: value})


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("fx", 0, "fx, fy are 0, 50.0; give pixels, above 0"),
        ("fy", -5.0, "fx, fy are 50.0, -5.0"),
        ("fx", np.nan, "fx, fy are nan"),
        ("width", 0, "width, height are 0, 30; give whole numbers of at least 1"),
        ("height", 3.5, "width, height are 40, 3.5"),
        ("cx", np.inf, "not finite"),
        ("translation", np.array([0, np.nan, 0]), "not finite"),
        ("translation", np.zeros(4), "have the shapes (3, 3), (4,)"),
        ("rotation", np.eye(2), "have the shapes (2, 2), (3,)"),
        ("rotation", np.zeros((3, 3)), "rotation is none"),
        ("rotation", 2 * np.eye(3), "rotation is none"),
        ("rotation", np.full((3, 3), np.nan), "rotation is none"),
        ("rotation", -np.eye(3), "rotation mirrors"),
    ],
)
def test_a_field_that_is_no_such_number_is_named(name, value, said):
    with pytest.raises(UsageError) as caught:
        Camera(**GOOD | {name: value})
    assert str(caught.value).startswith("camera: ")
    assert said in str(caught.value)
