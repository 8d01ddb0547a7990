"""The comparison helpers must be able to fail."""

import numpy as np
import pytest

from tests.compare import assert_close, central_difference, relative_l2


def test_assert_close_accepts_errors_within_the_bound():
    assert_close(np.array([1.0, 2.0]), np.array([1.0, 2.5]), np.array([0.0, 0.5]), "x")


def test_assert_close_names_the_worst_element():
    with pytest.raises(AssertionError, match=r"x\[1, 0\].*2 of 4 fail"):
        assert_close(
            np.array([[0.0, 1.1], [9.0, 1.0]]), np.array([[0.0, 1.0], [1.0, 1.0]]), 1e-3, "x"
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("side", [0, 1])
def test_assert_close_fails_on_non_finite_numbers(bad, side):
    pair = [np.zeros(3), np.zeros(3)]
    pair[side][1] = bad
    with pytest.raises(AssertionError, match=r"x\[1\]"):
        assert_close(*pair, 1e30, "x")


def test_assert_close_fails_on_another_shape():
    with pytest.raises(AssertionError, match="shape"):
        assert_close(np.zeros(3), np.zeros((3, 1)), 1.0)


def test_relative_l2():
    assert relative_l2(np.zeros(3), np.zeros(3)) == 0.0
    assert relative_l2(np.ones(3), np.zeros(3)) == np.inf
    assert not relative_l2(np.array([np.nan]), np.ones(1)) <= 1.0
    assert relative_l2(np.array([3.0, 0.0]), np.array([3.0, 4.0])) == pytest.approx(0.8)


def test_central_difference_of_a_cubic():
    x = np.array([[1.0, -2.0], [3.0, 0.0]])
    slopes = central_difference(lambda v: float((v**3).sum()), x, 1e-5)
    np.testing.assert_allclose(slopes, (3 * x**2).ravel(), rtol=1e-8, atol=1e-9)
    chosen = central_difference(lambda v: float((v**3).sum()), x, 1e-5, [(1, 0)])
    np.testing.assert_allclose(chosen, [27.0], rtol=1e-8)
