"""The detector velocity_filter on straight targets."""

import numpy as np
import pytest

import naive
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.pixel_statistics import measure
from track_before_detect.solvers.velocity.velocity_filter import VelocityFilterDetector

STAMPS = np.arange(12.0)


def detector(**options):
    return VelocityFilterDetector(DetectorOptions(
        detector='velocity_filter', **{'threshold': 6.0, 'max_speed_px_s': 1.0, **options}))


def scene(targets, shape=(48, 56), noise=0.0, seed=1, stamps=STAMPS):
    """Return frames with targets (x, y, v_x, v_y, amplitude) at the middle of the batch."""
    frames = noise * np.random.default_rng(seed).standard_normal((len(stamps), *shape))
    middle = 0.5 * (stamps[0] + stamps[-1])
    for x, y, v_x, v_y, amplitude in targets:
        for frame, stamp in zip(frames, stamps - middle, strict=True):
            add_target(frame, x + v_x * stamp, y + v_y * stamp, 1.0, amplitude)
    return frames.astype(np.float32)


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize('stamps', [
    pytest.param(STAMPS, id='regular'),
    pytest.param(np.array([0.0, 1, 2, 3, 6, 7, 7.5, 9, 10]), id='irregular')])
def test_target_without_noise_is_recovered_between_the_grid(sign, stamps):
    frames = scene([(24.3, 20.7, 0.43, -0.71, sign * 5.0)], stamps=stamps)
    options = {'amplitudes': 'signed'} if sign < 0 else {}
    [found] = detector(**options).detect(frames, stamps).found
    middle = stamps - 0.5 * (stamps[0] + stamps[-1])
    np.testing.assert_allclose(
        found.positions, np.column_stack([24.3 + 0.43 * middle, 20.7 - 0.71 * middle]), atol=0.02)
    np.testing.assert_allclose(found.amplitudes, sign * 5.0, rtol=1e-2)
    assert found.statistic == pytest.approx(5.0 * np.sqrt(len(stamps)), rel=1e-2)
    assert found.snr == pytest.approx(sign * 5.0, rel=1e-2)


@pytest.mark.parametrize('snr', [2.5, 30.0])
def test_every_target_is_found_once(snr):
    made = simulate('three_targets', 3, snr=snr, fps=1.0)
    found = detector().detect(made.frames, made.stamps).found
    truth = made.truth[:, 2:].reshape(3, 20, 2)
    nearest = [int(np.argmin([np.hypot(*(t.positions - path).T).mean() for path in truth]))
               for t in found]
    assert sorted(nearest) == [0, 1, 2]


def test_targets_side_by_side_and_crossing_are_told_apart():
    targets = [(20.0, 14.0, 0.5, 0.2, 4.0), (19.0, 17.5, 0.5, 0.2, 4.0),
               (36.0, 33.0, 0.6, 0.0, 4.0), (36.0, 33.0, 0.0, 0.6, 4.0)]
    found = detector().detect(scene(targets, noise=1.0), STAMPS).found
    assert len(found) == 4
    middle = np.array([t.positions[[5, 6]].mean(axis=0) for t in found])
    for x, y, *_ in targets:
        assert np.hypot(middle[:, 0] - x, middle[:, 1] - y).min() < 1


def test_target_that_enters_is_followed_in_the_frames_it_is_in():
    frames = scene([(1.5, 20.0, 0.9, 0.1, 5.0)], noise=1.0)
    [found] = detector().detect(frames, STAMPS).found
    absent = np.isnan(found.amplitudes)
    assert 3 <= absent.sum() <= 5 and not absent[5:].any()
    assert np.all(found.positions[absent, 0] < -0.4)
    assert found.statistic > 4.0 * np.sqrt((~absent).sum())


def test_masked_pixels_carry_no_weight():
    frames = scene([(24.0, 20.0, 0.5, 0.3, 5.0)], noise=1.0)
    frames[3:5] = np.nan
    frames[8, 15:30] = np.nan
    frames[:, 21, 24] = np.nan
    [found] = detector().detect(frames, STAMPS).found
    assert found.amplitudes[0] == pytest.approx(5.0, abs=1.2)
    assert np.hypot(*(found.positions[0] - (24 - 2.75, 20 - 1.65))) < 0.7


def test_noisy_pixels_carry_less_weight():
    deviation = np.where(np.arange(56) < 28, 1.0, 6.0) * np.ones((48, 56))
    frames = scene([(28.0, 24.0, 0.6, 0.0, 5.0)])
    frames += deviation * np.random.default_rng(5).standard_normal(frames.shape)
    weights = (1 / deviation)[None].astype(np.float32)
    [found] = detector().detect_weighted((frames * weights).astype(np.float32), STAMPS,
                                         weights).found
    assert found.amplitudes[0] == pytest.approx(5.0, abs=1.5)
    stamp = GaussianPsf(1.0)
    data = measure(frames * weights, stamp, weights)
    # A statistic of unit variance: the data over the noise, weighed once more.
    assert found.statistic > 5.0 * np.sqrt(data.phi[:6, 24, 20].sum()) * 0.7


def test_statistic_has_unit_variance_under_masks_and_variance():
    rng = np.random.default_rng(6)
    deviation = rng.uniform(0.5, 3.0, (1, 20, 22))
    noise = rng.standard_normal((400, 20, 22))
    noise[:, rng.random((20, 22)) < 0.2] = np.nan
    data = measure(noise, GaussianPsf(1.0), 1 / deviation)
    h = data.psi[0] / np.sqrt(data.phi)
    assert np.std(h) == pytest.approx(1.0, abs=0.03)


def test_grids_that_differ_after_four_frames_have_calibrations_of_their_own():
    uneven = np.r_[0.0, 1, 2, 3, 4, 7, 7.2, 7.5, 8, 9, 10, 11]
    grids = [detector().grid(stamps, (48, 56)) for stamps in (STAMPS, uneven)]
    assert grids[0].moves.shape == grids[1].moves.shape
    assert grids[0].moves.ravel()[:4].tolist() == grids[1].moves.ravel()[:4].tolist()
    assert (grids[0].moves != grids[1].moves).any()
    first, other = (detector().noise_study(stamps, (48, 56)).key for stamps in (STAMPS, uneven))
    assert first != other
    # Twice as fast at twice the rate is the same search.
    assert detector(max_speed_px_s=2.0).noise_study(STAMPS / 2, (48, 56)).key == first


def test_threshold_holds_the_false_alarm_rate_asked_for(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr('track_before_detect.solvers.calibration.threshold.MOST_CROPS', 500)
    made = detector(threshold=None, false_alarm_rate=0.1, max_speed_px_s=0.5)
    stamps, shape = np.arange(6.0), (24, 24)
    made.threshold(stamps, shape)
    rng = np.random.default_rng(8)
    n_runs = 300
    alarms = sum(bool(made.detect(rng.standard_normal((6, *shape)), stamps).found)
                 for _ in range(n_runs))
    # Four standard deviations of the count and of the threshold about the rate.
    assert 0.02 < alarms / n_runs < 0.19


def test_velocities_are_those_of_a_disc_one_pixel_per_batch_apart():
    grid = detector().grid(STAMPS, (48, 56))
    assert grid.step == pytest.approx(1 / 11)
    speeds = [np.hypot(*grid.velocity(i * len(grid.axis) + j))
              for i, j in naive.velocity_numbers(grid)]
    assert len(speeds) == grid.n_velocities and max(speeds) <= 1 + 1e-9
    assert detector(motion_model='static').grid(STAMPS, (48, 56)).n_velocities == 1


def test_effective_area_is_the_mean_spread_of_the_times_inside():
    grid = detector().grid(STAMPS[:6], (9, 12))
    spreads = []
    for number in naive.velocity_numbers(grid):
        velocity = grid.velocity(number[0] * len(grid.axis) + number[1])
        for y, x in np.ndindex(9, 12):
            at = np.array([x, y]) + grid.times[:, None] * velocity
            inside = ((at >= -0.5) & (at <= [11.5, 8.5])).all(axis=1)
            spreads.append(np.var(grid.times[inside]) / np.var(grid.times))
    assert grid.effective_area((9, 12)) == pytest.approx(9 * 12 * np.mean(spreads), rel=1e-9)
    # Beside large frames the border is of no matter, nor is it for what stands still.
    assert grid.effective_area((3000, 2000)) == pytest.approx(6e6, rel=0.01)
    still = detector(motion_model='static').grid(STAMPS, (9, 12))
    assert still.effective_area((9, 12)) == 9 * 12


def test_a_search_too_large_is_cut_with_a_warning(caplog):
    made = detector(max_speed_px_s=50.0)
    grid = made.grid(np.arange(30.0), (512, 512))
    assert grid.axis.max() < 50 and 'would be too large' in caplog.text


@pytest.mark.parametrize(('option', 'said'), [
    ({'motion_model': 'range_doppler'}, "motion_model must be one of .*, got 'range_doppler'"),
    ({'presence': 'partial'}, "presence must be full, got 'partial'"),
])
def test_what_it_cannot_do_is_refused(option, said):
    with pytest.raises(ParameterError, match=said):
        detector(**option)
    with pytest.raises(DataError, match='complex'):
        detector().detect(np.zeros((12, 8, 8), complex), STAMPS)
