import dataclasses

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from naive import gaussian_stamp_image
from track_before_detect.errors import ParameterError
from track_before_detect.simulation.backdrop import backdrop
from track_before_detect.simulation.scenarios import Scenario, SCENARIOS, simulate
from track_before_detect.simulation.sensor import add_path


def paths(recording):
    """Return positions (N, T, 2) from truth rows."""
    n_frames = len(recording.frames)
    return recording.truth[:, 2:].reshape(-1, n_frames, 2)


@given(st.floats(0.3, 4.0), st.floats(30, 50), st.floats(30, 50))
def test_stamp_inside_has_unit_norm_and_is_centred(sigma, x, y):
    image = gaussian_stamp_image((80, 81), x, y, sigma)
    assert np.linalg.norm(image) == pytest.approx(1.0, abs=1e-9)
    rows, columns = np.indices(image.shape)
    # Squared samples are the sharper Gaussian; below one pixel its sampling shifts the centroid.
    if sigma >= 1.0:
        assert (image * columns).sum() / image.sum() == pytest.approx(x, abs=1e-3)
        assert (image * rows).sum() / image.sum() == pytest.approx(y, abs=1e-3)


@settings(max_examples=50)
@given(st.floats(-30, 60), st.floats(-30, 60), st.floats(0.3, 4.0))
def test_stamp_is_cut_at_the_border_not_scaled(x, y, sigma):
    large = gaussian_stamp_image((160, 160), x + 60, y + 60, sigma)
    small = gaussian_stamp_image((20, 30), x, y, sigma)
    np.testing.assert_allclose(small, large[60:80, 60:90], atol=1e-12)


def test_path_is_drawn_in_the_frames_it_is_in_with_the_amplitude_of_each():
    frames = np.zeros((3, 20, 30))
    path = np.array([[9.3, 8.2], [np.nan, np.nan], [12.0, 7.5]])
    add_path(frames, path, 1.2, [2.0, 5.0, 3.0])
    for frame, (x, y), amplitude in zip(frames[::2], path[::2], (2.0, 3.0), strict=True):
        np.testing.assert_allclose(frame, amplitude * gaussian_stamp_image((20, 30), x, y, 1.2))
    assert not frames[1].any()
    # Smeared along its way, a target has the same norm.
    smeared = np.zeros((3, 40, 40))
    add_path(smeared, path + 10, 1.2, 2.0, np.full((3, 2), 3.0))
    np.testing.assert_allclose(np.linalg.norm(smeared, axis=(1, 2)), [2, 0, 2])
    assert smeared.max() < frames[0].max()


@pytest.mark.parametrize('name', SCENARIOS)
def test_same_seed_same_recording(name):
    first, second, other = simulate(name, 5), simulate(name, 5), simulate(name, 6)
    np.testing.assert_array_equal(first.frames, second.frames)
    np.testing.assert_array_equal(first.truth, second.truth)
    assert (first.frames != other.frames).any()


def test_doppler_of_a_target_says_how_fast_its_range_changes():
    for seed in range(5):
        made = simulate('range_doppler', seed, fps=2.0)
        scenario = made.scenario
        column, row = paths(made)[0].T
        rate = scenario.range_bins_per_doppler_bin * (column - scenario.width // 2)
        np.testing.assert_allclose(
            np.diff(row), 0.5 * (rate[1:] + rate[:-1]) / scenario.fps, atol=1e-9)
        assert abs(column[-1] - column[0]) <= scenario.doppler_drift_bins


@pytest.mark.parametrize('name', SCENARIOS)
def test_targets_stay_inside_and_within_the_speed(name):
    for seed in range(10):
        made = simulate(name, seed)
        scenario = made.scenario
        assert made.frames.shape == (scenario.n_frames, scenario.height, scenario.width)
        assert made.frames.dtype == np.float32
        assert len(made.truth) == scenario.n_targets * scenario.n_frames
        np.testing.assert_allclose(np.diff(made.stamps), 1 / scenario.fps)
        positions = paths(made)
        assert (positions >= scenario.border_px - 1e-9).all()
        limit = np.array([scenario.width, scenario.height]) - 1 - scenario.border_px
        assert (positions <= limit + 1e-9).all()
        speed = np.hypot(*np.diff(positions, axis=1).T)
        assert (speed <= scenario.speed_px_per_frame + 1e-9).all()
        # The default of max_speed_px_s is one pixel per frame; maps go by their Doppler.
        assert scenario.speed_px_per_frame <= 1.0 or scenario.motion == 'range_doppler'


def test_three_targets_is_what_it_promises():
    assert dataclasses.asdict(SCENARIOS['three_targets']) | {
        'height': 128, 'width': 128, 'n_frames': 20, 'psf_sigma_px': 1.0, 'snr': 3.0,
        'n_targets': 3, 'speed_px_per_frame': 1.0, 'separation_px': 12.0, 'motion': 'lines',
    } == dataclasses.asdict(SCENARIOS['three_targets'])
    for seed in range(50):
        a, b, c = paths(simulate('three_targets', seed))
        for one, two in ((a, b), (a, c), (b, c)):
            assert np.hypot(*(one - two).T).min() >= 12.0


def test_noise_has_unit_deviation_and_no_target():
    frames = simulate('noise', 0).frames
    assert frames.std() == pytest.approx(1.0, abs=0.005)
    assert abs(frames.mean()) < 0.01


def test_a_background_passes_through_the_picture_and_leaves_noise_and_targets_alone():
    first, *_, last = backdrop(np.random.default_rng(0), (4, 30, 40), {3.0: 5.0}, (2.0, -1.0))
    # Three steps to the right and up.
    np.testing.assert_allclose(last[3:, :-6], first[:-3, 6:], atol=1e-5)
    assert first.std() == pytest.approx(5.0, rel=0.2)
    behind = simulate('eo_ir_turning', 1).frames - simulate(
        'eo_ir_turning', 1, background_rms=0.0).frames
    assert behind.std() == pytest.approx(12.0, rel=0.3)
    still = simulate('eo_ir_turning', 1, background_speed_px_per_frame=0.0)
    np.testing.assert_array_equal(still.truth, simulate('eo_ir_turning', 1).truth)
    still.frames[:] -= simulate('eo_ir_turning', 1, background_rms=0.0).frames
    np.testing.assert_allclose(still.frames, np.broadcast_to(still.frames[0], behind.shape),
                               atol=1e-4)


def test_another_sensor_sees_the_same_targets_from_elsewhere_in_noise_of_its_own():
    one, other = (simulate('single_target', 3, sensor=sensor, view_x_px=4.5 * sensor, snr=40.0)
                  for sensor in (0, 1))
    np.testing.assert_allclose(other.truth, one.truth - [0, 0, 4.5, 0])
    alone = [simulate('noise', 3, sensor=sensor).frames.ravel() for sensor in (0, 1, 2)]
    assert np.abs(np.corrcoef(alone) - np.eye(3)).max() < 0.01
    for made in (one, other):
        k, _, x, y = made.truth[7]
        frame = made.frames[int(k)]
        seen = (frame * gaussian_stamp_image(frame.shape, x, y, 1.0)).sum()
        assert seen == pytest.approx(40.0, abs=4.0)


@pytest.mark.parametrize(('name', 'kinds'), [('three_targets', 'constant'),
                                             ('radar_plots', 'fluctuating')])
def test_snr_is_the_amplitude_of_the_unit_norm_stamp(name, kinds):
    found = []
    for seed in range(8):
        made = simulate(name, seed, snr=20.0)
        for k, _, x, y in made.truth:
            frame = made.frames[int(k)]
            found.append((frame * gaussian_stamp_image(frame.shape, x, y, 1.0)).sum())
    found = np.array(found)
    # Each has noise of standard deviation 1.
    assert np.sqrt((found ** 2).mean() - 1) == pytest.approx(20.0, rel=0.06)
    assert (found.std() < 1.2) == (kinds == 'constant')


def test_spread_of_snr_is_between_targets():
    made = simulate('eo_ir_drones', 3, snr=50.0, snr_spread=2.0, n_targets=8)
    amplitudes = np.array([
        (made.frames[int(k)] * gaussian_stamp_image((128, 128), x, y, 1.0)).sum()
        for k, _, x, y in made.truth]).reshape(8, -1)
    means = amplitudes.mean(axis=1)
    assert ((means > 48) & (means < 102)).all() and means.std() > 5
    assert (amplitudes.std(axis=1) < 2).all()


def test_crossing_targets_meet_in_the_middle_at_right_angles():
    a, b = paths(simulate('crossing', 1))
    distance = np.hypot(*(a - b).T)
    assert distance.argmin() in (9, 10) and distance.min() < 1
    assert distance[0] > 8 and distance[-1] > 8
    assert np.dot(a[-1] - a[0], b[-1] - b[0]) == pytest.approx(0.0, abs=1e-9)


def test_parallel_targets_keep_their_distance():
    a, b = paths(simulate('parallel', 1, separation_px=7.0))
    np.testing.assert_allclose(np.hypot(*(a - b).T), 7.0)


def test_arc_has_its_radius():
    path, = paths(simulate('maneuver', 2, radius_px=15.0, n_frames=60))
    ends = path[0], path[30], path[59]
    a, b, c = (np.linalg.norm(ends[i] - ends[j]) for i, j in ((1, 2), (0, 2), (0, 1)))
    area = 0.5 * abs(np.linalg.det(np.array([ends[1] - ends[0], ends[2] - ends[0]])))
    assert a * b * c / (4 * area) == pytest.approx(15.0, rel=1e-9)


def test_noise_does_not_depend_on_the_targets():
    with_targets = simulate('three_targets', 4).frames
    without = simulate('three_targets', 4, snr=0.0).frames
    np.testing.assert_array_equal(simulate('noise', 4).frames, without)
    assert np.abs(with_targets - without).max() > 1


@pytest.mark.parametrize(
    ('overrides', 'message'),
    [({'snrr': 3}, "unknown parameter 'snrr'.*did you mean snr"),
     ({'snr': 'loud'}, "snr must be a number, got 'loud'"),
     ({'snr': float('nan')}, 'snr must be a number'),
     ({'n_frames': 2.5}, 'n_frames must be a whole number'),
     ({'n_frames': 0}, 'n_frames must be at least 1, got 0'),
     ({'fps': 0}, 'fps must be above 0 Hz'),
     ({'motion': 'zigzag'}, 'motion must be one of lines'),
     ({'motion': 'crossing'}, 'n_targets must be 2 for motion crossing, got 3'),
     ({'border_px': 70}, 'border_px must leave room'),
     ({'height': 20, 'width': 20, 'n_targets': 30}, 'cannot place 30 targets')])
def test_bad_override_is_refused_in_one_sentence(overrides, message):
    with pytest.raises(ParameterError, match=message):
        simulate('three_targets', 0, **overrides)


@pytest.mark.parametrize(('name', 'seed', 'message'), [
    ('three_target', 0, 'did you mean three_targets'), ('zzz', 0, 'known: eo_ir_drones'),
    ('noise', -1, 'seed'), ('noise', 1.5, 'seed'), ('noise', True, 'seed')])
def test_bad_name_or_seed_is_refused(name, seed, message):
    with pytest.raises(ParameterError, match=message):
        simulate(name, seed)


def test_numbers_may_come_as_text():
    assert simulate('noise', 0, n_frames='3', fps='10').scenario.n_frames == 3


def test_every_parameter_is_described():
    for field in dataclasses.fields(Scenario)[1:]:
        assert field.metadata['description'].endswith('.')
