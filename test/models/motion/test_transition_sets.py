import itertools

import numpy as np
import pytest

from track_before_detect.models.motion.transition_sets import directional_sets, transition_sets


def test_four_directions_are_the_quadrants_of_the_paper():
    quadrants = [{(0, 0), (0, 1), (1, 0), (1, 1)}, {(0, 0), (0, 1), (-1, 0), (-1, 1)},
                 {(0, 0), (0, -1), (-1, 0), (-1, -1)}, {(0, 0), (0, -1), (1, 0), (1, -1)}]
    assert [sets.pixels(0) for sets in directional_sets([1] * 6, 4)] == quadrants


@pytest.mark.parametrize('reach', [0, 1, 2, 5])
@pytest.mark.parametrize('n_directions', [1, 2, 3, 4, 5, 8, 13, 40])
def test_directions_together_are_the_whole_set(reach, n_directions):
    parts = [sets.pixels(0) for sets in directional_sets([reach] * 3, n_directions)]
    square = range(-reach, reach + 1)
    assert set.union(*parts) == set(itertools.product(square, square))
    assert not any(a < b for a in parts for b in parts)
    assert all((0, 0) in part for part in parts)


def test_a_longer_interval_has_a_larger_set():
    sets = transition_sets([0, 1, 2, 1])
    np.testing.assert_array_equal(sets.sizes[sets.sets], [1, 9, 25, 9])
