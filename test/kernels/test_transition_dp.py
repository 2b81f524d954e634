"""Dynamic programming over transition sets and target cancellation, beside slow twins."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels import transition_dp
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.transition_sets import directional_sets, transition_sets
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure, Merit

SETS = [
    pytest.param([1] * 5, 1, id='9'), pytest.param([2] * 5, 1, id='25'),
    pytest.param([1] * 5, 4, id='4 of 9'), pytest.param([2] * 5, 4, id='9 of 25'),
    pytest.param([3] * 5, 5, id='fifths of 49'), pytest.param([0, 1, 2, 1, 0], 3, id='irregular'),
]


def everything(scores):
    n_frames, n_y, n_x = scores.shape
    return np.tile([0, n_y, 0, n_x], (n_frames, 1))


def in_order(sets):
    """Return the predecessors (dx, dy) for each frame, in the order in which ties are broken."""
    rows = [sets.rows[sets.row_first[k]:sets.row_first[k + 1]] for k in sets.sets]
    return [[(dx, dy) for dy, first, last in part for dx in range(first, last + 1)]
            for part in rows]


@pytest.mark.parametrize(('reaches', 'n_directions'), SETS)
@pytest.mark.parametrize('shape', [(11, 37), (1, 9), (3, 2)])
def test_merit_function_equals_the_recursion_pixel_by_pixel(reaches, n_directions, shape):
    scores = np.random.default_rng(1).exponential(size=(5, *shape)).astype(np.float32)
    for sets in directional_sets(reaches, n_directions):
        merit = np.full_like(scores, np.nan)
        n = transition_dp.accumulate(merit, scores, sets.rows, sets.row_first, sets.sets,
                                     everything(scores))
        expected = naive.transition_merit(scores, [sets.pixels(k) for k in sets.sets])
        np.testing.assert_allclose(merit, expected, rtol=1e-5)
        assert n == scores[0].size * sum(sets.sizes[k] for k in sets.sets[1:])


def test_part_of_the_merit_function_is_computed_in_place():
    scores = np.random.default_rng(2).exponential(size=(4, 9, 12)).astype(np.float32)
    sets = transition_sets([1] * 4)
    merit = np.full_like(scores, -5)
    arguments = (sets.rows, sets.row_first, sets.sets)
    transition_dp.accumulate(merit, scores, *arguments, everything(scores))
    whole = merit.copy()
    merit[2, 3:5, 4:9] = np.nan
    boxes = np.zeros((4, 4), int)
    boxes[2] = 3, 5, 4, 9
    transition_dp.accumulate(merit, scores, *arguments, boxes)
    np.testing.assert_array_equal(merit, whole)


@pytest.mark.parametrize('merit', [Merit(True), Merit(False), Merit(True, True),
                                   Merit(False, True)])
@pytest.mark.parametrize('is_complex', [False, True])
@pytest.mark.parametrize(('sigma', 'n_directions'), [(0.3, 1), (0.3, 4), (1.0, 1), (1.0, 3)])
def test_targets_equal_those_of_computing_everything_again(merit, is_complex, sigma,
                                                          n_directions):
    rng = np.random.default_rng(3)
    shape = (5, 16, 17)
    frames = rng.standard_normal(shape)
    if is_complex:
        frames = (frames + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    for x, y, step in ((3, 4, 1), (12, 10, 0), (1, 13, 2)):
        for t in range(5):
            frames[t, y, min(16, x + step * t)] += 6
    frames[1, 3:5, 2:9] = np.nan
    psf = GaussianPsf(sigma)
    data = measure(frames, psf)
    sets = directional_sets([1] * 5, n_directions)[0]
    bound = {(0.3, True): 60.0, (0.3, False): 14.0, (1.0, True): 25.0, (1.0, False): 8.0}[
        sigma, merit.squared]
    expected = naive.cancelled_targets(
        data.psi, data.phi, data.weights, data.stamp, exclusion_levels(psf), merit.squared,
        merit.signed, in_order(sets), bound)
    paths = np.empty((50, 5, 2), np.int32)
    seen = np.empty((50, len(data.psi), 5), np.float32)
    values = np.empty(50, np.float32)
    n, left, _ = transition_dp.find_targets(
        data.psi, data.phi, data.weights, data.stamp, exclusion_levels(psf), merit.squared,
        merit.signed, data.scores(merit), np.empty(shape, np.float32), np.zeros_like(data.psi),
        np.zeros(shape, bool), sets.rows, sets.row_first, sets.sets, np.float32(bound), paths,
        seen, values)
    assert n == len(expected) > 0
    assert left <= bound
    for i, (path, path_seen, value) in enumerate(expected):
        np.testing.assert_array_equal(paths[i], path)
        np.testing.assert_allclose(seen[i], path_seen, rtol=1e-3, atol=1e-3)
        assert values[i] == pytest.approx(value, rel=1e-4)
