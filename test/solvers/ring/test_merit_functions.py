"""Merit functions of the Ring paper against slow twins, and what they have to satisfy."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

import naive
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.models.motion.velocity_candidates import (
    half_velocities,
    straight_lines,
    whole_velocities,
)
from track_before_detect.solvers.ring.merit_functions import merit_functions, METHODS


def noise(seed, *shape):
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


def slow_merit(frames, method, v_max):
    """Return what the compiled merit function has to equal."""
    order, ring = METHODS[method].order, METHODS[method].ring
    if order == 'cfo':
        return (naive.first_order_ring if ring else naive.first_order_merit)(frames, v_max)
    twin = naive.SecondOrderTwin(frames, order, straight_lines(v_max))
    return twin.ring() if ring else np.array([merit for _, merit, _ in twin.forward()])


@pytest.mark.parametrize('v_max, first, second', [(1, 9, 49), (2, 25, 165)])
def test_candidates_are_as_many_as_the_table_of_the_paper_says(v_max, first, second):
    assert len(whole_velocities(v_max)) == first
    assert len(straight_lines(v_max)) == second


@pytest.mark.parametrize('v_max', [0, 1, 2, 3])
def test_candidates_are_symmetric_and_slowest_first(v_max):
    for velocities in (whole_velocities(v_max), half_velocities(v_max)):
        assert {tuple(v) for v in velocities} == {tuple(-v) for v in velocities}
        assert np.all(np.diff(np.sum(velocities**2, axis=1)) >= 0)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), method=st.sampled_from(list(METHODS)),
       v_max=st.integers(0, 2), n_frames=st.integers(3, 6), height=st.integers(1, 5),
       width=st.integers(1, 5), whole=st.booleans())
def test_merit_functions_equal_their_slow_twin(seed, method, v_max, n_frames, height, width,
                                               whole):
    frames = noise(seed, n_frames, height, width)
    if whole:
        # Equal values are common then, so that the order of the candidates shows.
        frames = np.rint(2 * frames)
    np.testing.assert_allclose(merit_functions(frames, method, v_max),
                               slow_merit(frames, method, v_max), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('v_max', [1, 2, 4])
def test_threads_change_nothing(method, v_max):
    frames = noise(1, 40, 70, 33)
    np.testing.assert_array_equal(merit_functions(frames, method, v_max, 1),
                                  merit_functions(frames, method, v_max, 2))


@pytest.mark.parametrize('method', ['cfo_dp', 'mff_dp', 'cso_dp'])
def test_fast_velocities_equal_the_slow_twin(method):
    frames = np.rint(2 * noise(2, 5, 2, 14))
    np.testing.assert_allclose(merit_functions(frames, method, 7), slow_merit(frames, method, 7),
                               rtol=1e-5)


@pytest.mark.parametrize('method', METHODS)
def test_merit_function_turns_with_the_image(method):
    frames = noise(3, 8, 12, 9)
    turned = merit_functions(frames.transpose(0, 2, 1)[:, ::-1], method, 1)
    np.testing.assert_allclose(turned[:, ::-1].transpose(0, 2, 1),
                               merit_functions(frames, method, 1), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('velocity', [(0.0, 0.0), (0.5, -1.0), (1.0, 0.5), (-2.0, 1.5)])
def test_merit_function_without_noise_is_largest_on_the_target(method, velocity):
    v_max = int(np.ceil(np.max(np.abs(velocity))))
    n_frames = 12
    positions = np.floor(np.array([30, 20]) + np.outer(np.arange(n_frames), velocity)).astype(int)
    frames = np.zeros((n_frames, 44, 54), np.float32)
    frames[np.arange(n_frames), positions[:, 1], positions[:, 0]] = 1
    merit = merit_functions(frames, method, v_max)
    largest = merit.max(axis=(1, 2))
    np.testing.assert_array_equal(
        merit[np.arange(n_frames), positions[:, 1], positions[:, 0]], largest)
    assert (merit == largest[:, None, None]).sum() == n_frames


def test_first_order_merit_of_a_still_target_is_its_number_of_frames():
    frames = np.zeros((9, 5, 5), np.float32)
    frames[:, 2, 2] = 1
    merit = merit_functions(frames, 'cfo_dp', 1)
    np.testing.assert_array_equal(merit[:, 2, 2], np.arange(1, 10))


@pytest.mark.parametrize('call, error, words', [
    (lambda frames: merit_functions(frames, 'dp', 1), ParameterError, "got 'dp'"),
    (lambda frames: merit_functions(frames, 'mff_dp', 8), ParameterError, 'up to 7 pixels'),
    (lambda frames: merit_functions(frames, 'mff_dp', -1), ParameterError, 'got -1'),
    (lambda frames: merit_functions(frames, 'cfo_dp', 0.5), ParameterError, 'got 0.5'),
    (lambda frames: merit_functions(frames[0], 'mff_dp', 1), DataError, r'got \(5, 5\)'),
    (lambda frames: merit_functions(frames[:2], 'cso_dp', 1), DataError, 'at least 3 frames'),
    (lambda frames: merit_functions(1j * frames, 'cfo_dp', 1), DataError, 'complex'),
], ids=['method', 'too fast', 'negative', 'not whole', 'one frame', 'two frames', 'complex'])
def test_what_cannot_be_accumulated_is_refused(call, error, words):
    with pytest.raises(error, match=words):
        call(noise(0, 4, 5, 5))
