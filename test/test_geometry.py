"""Maps take positions there and back."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np

from track_before_detect import geometry

SMALL = st.floats(-0.3, 0.3)


@settings(max_examples=50, deadline=None)
@given(st.lists(SMALL, min_size=8, max_size=8), st.floats(-100, 100), st.floats(-100, 100))
def test_the_inverse_takes_every_position_back(changes, x, y):
    matrix = np.eye(3) + np.append(changes, 0.0).reshape(3, 3) * np.array([[1], [1], [0.003]])
    there = geometry.apply(matrix, np.array([x, y]))
    np.testing.assert_allclose(
        geometry.apply(geometry.inverse(matrix), there), (x, y), atol=1e-6)


def test_translations_add_their_offset():
    offsets = np.array([(1.5, -2.0), (0.0, 7.0)])
    maps = geometry.translations(offsets)
    np.testing.assert_allclose(geometry.apply(maps, np.full((2, 2), 3.0)), 3.0 + offsets)


def test_what_lies_behind_the_horizon_is_nowhere():
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]])
    assert np.isnan(geometry.apply(matrix, np.array([[10.0, 1], [20, 1]]))).all()
    assert np.isfinite(geometry.apply(matrix, np.array([9.0, 1]))).all()


@settings(max_examples=50, deadline=None)
@given(st.lists(SMALL, min_size=8, max_size=8), st.floats(-100, 100), st.floats(-100, 100))
def test_slopes_are_the_derivatives_of_a_map(changes, x, y):
    matrix = np.eye(3) + np.append(changes, 0.0).reshape(3, 3) * np.array([[1], [1], [0.003]])
    place, step = np.array([[x, y]]), 1e-4
    moved = [(geometry.apply(matrix, place + step * axis) - geometry.apply(
        matrix, place - step * axis)) / (2 * step) for axis in np.eye(2)]
    np.testing.assert_allclose(geometry.slopes(matrix[None], place)[0], np.vstack(moved).T,
                               atol=1e-5)


def test_a_translation_is_told_from_other_maps():
    assert all(geometry.is_translation(one)
               for one in geometry.translations(np.array([(0.0, 0.0), (3.5, -2)])))
    for row, column, value in ((0, 0, 1.001), (1, 0, 0.001), (2, 1, 1e-9), (2, 2, 2.0)):
        other = np.eye(3)
        other[row, column] = value
        assert not geometry.is_translation(other)
