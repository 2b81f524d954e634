"""A recording cut into batches gives each target once, in each frame once."""

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import at_most_cores
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.recording import batches, detect_recording
from track_before_detect.types import FrameBatch

OPTIONS = {'threshold': 12.0}


def moving_target(n_frames, amplitude=6.0, seed=1, shape=(32, 64)):
    frames = np.random.default_rng(seed).standard_normal((n_frames, *shape))
    x = 8 + 0.7 * np.arange(n_frames)
    truth = np.stack([x, np.full(n_frames, 14.3)], axis=1)
    rows, columns = np.mgrid[:shape[0], :shape[1]]
    for t in range(n_frames):
        stamp = np.exp(-((columns - truth[t, 0])**2 + (rows - truth[t, 1])**2) / 2)
        frames[t] += amplitude * stamp / np.linalg.norm(stamp)
    return frames, truth


@pytest.mark.parametrize(('n_frames', 'length', 'hop'), [
    (10, 20, 10), (20, 20, 10), (21, 20, 10), (50, 20, 7), (40, 20, 20)])
def test_batches_cover_every_frame_and_end_with_the_last(n_frames, length, hop):
    frames = np.zeros((n_frames, 2, 2))
    made = list(batches(frames, [np.arange(n_frames)], np.arange(float(n_frames)), length, hop))
    starts = [int(batch.frame_indices[0]) for batch in made]
    assert {index for batch in made for index in batch.frame_indices} == set(range(n_frames))
    assert starts == sorted(set(starts))
    assert starts[-1] == max(0, n_frames - length)
    assert all(len(batch) == min(length, n_frames) for batch in made)


@pytest.mark.parametrize('options', [
    {}, {'batch_length': 20}, {'batch_length': 20, 'hop': 20}, {'batch_length': 15, 'hop': 4}])
def test_one_target_is_one_trajectory_over_all_frames(options):
    frames, truth = moving_target(55)
    result = tbd.detect(frames, **OPTIONS, **options)
    assert len(result.trajectories) == 1
    trajectory = result.trajectories[0]
    assert trajectory.positions.shape == (55, 2)
    assert np.hypot(*(trajectory.positions - truth).T).max() < 1.5
    assert trajectory.velocity[:, 0].mean() == pytest.approx(0.7, abs=0.05)
    assert trajectory.statistic > result.threshold


def test_rows_over_the_frames_of_its_batches_alone_are_the_same_trajectory():
    frames, _ = moving_target(50)
    noise = np.random.default_rng(2).standard_normal(frames.shape)
    frames[:20], frames[40:] = noise[:20], noise[40:]
    recording = _Recording(frames, np.arange(50.0))
    options = DetectorOptions(**OPTIONS, batch_length=10, hop=10)
    [whole] = detect_recording(recording, options).trajectories
    [short] = detect_recording(recording, options, over_all_frames=False).trajectories
    assert short.frame_indices.tolist() == list(range(20, 40))
    for name in ('positions', 'amplitudes', 'velocity', 'stamps', 'covariance'):
        np.testing.assert_array_equal(getattr(short, name), getattr(whole, name)[20:40])
    assert np.isnan(np.delete(whole.positions, np.s_[20:40], axis=0)).all()


def test_frames_without_the_target_are_nan():
    frames, truth = moving_target(30)
    frames[20:] = np.random.default_rng(2).standard_normal((10, *frames.shape[1:]))
    result = tbd.detect(frames, **OPTIONS, batch_length=10, hop=10)
    positions = result.trajectories[0].positions
    assert np.isfinite(positions[:20]).all()
    assert np.isnan(positions[20:]).all()


def test_batch_without_a_finite_pixel_is_passed_over(caplog):
    frames, truth = moving_target(30)
    frames[10:20] = np.nan
    result = tbd.detect(frames, **OPTIONS, batch_length=10, hop=10)
    assert result.n_batches == 2
    assert 'frames 10 to 19 hold no finite pixel' in caplog.text
    found = np.any([np.isfinite(found.positions[:, 0]) for found in result.trajectories], axis=0)
    np.testing.assert_array_equal(found, np.repeat([True, False, True], 10))


def test_recording_without_a_finite_pixel_is_refused():
    with pytest.raises(tbd.DataError, match='no pixel of the 30 frames is finite'):
        tbd.detect(np.full((30, 8, 8), np.nan), **OPTIONS, batch_length=10, hop=10)


def test_dropped_frames_do_not_shift_the_target():
    frames, truth = moving_target(30)
    keep = np.delete(np.arange(30), [4, 5, 13, 22])
    result = tbd.detect(frames[keep], stamps=keep.astype(float), **OPTIONS)
    assert len(result.trajectories) == 1
    assert np.hypot(*(result.trajectories[0].positions - truth[keep]).T).max() < 1.5


@pytest.mark.parametrize('stamps', [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 2.0]])
def test_stamps_of_an_array_that_do_not_increase_are_refused(stamps):
    with pytest.raises(tbd.DataError, match='stamps must'):
        tbd.detect(np.zeros((3, 8, 8)), stamps, **OPTIONS)
    with pytest.raises(tbd.DataError, match='stamps of sensor 0 must'):
        tbd.detect_sensors([tbd.Sensor(np.zeros((3, 8, 8)), stamps)], **OPTIONS)


@pytest.fixture
def recorded(tmp_path):
    """Return a function from frames and stamps to what is found in their file."""
    def found(frames, stamps, **options):
        write_npz_recording(tmp_path / 'a.npz', frames, stamps)
        with open_recording(tmp_path / 'a.npz') as recording:
            return detect_recording(recording, DetectorOptions(**OPTIONS, **options))
    return found


@pytest.mark.parametrize('wrong', [0.0, 0.36, np.nan, 1e9])
def test_a_wrong_stamp_of_a_recording_costs_its_frame(recorded, caplog, wrong):
    frames, truth = moving_target(30)
    stamps = 0.04 * np.arange(30)
    stamps[10] = wrong
    result = recorded(frames, stamps)
    [trajectory] = result.trajectories
    seen = np.isfinite(trajectory.positions[:, 0])
    assert np.flatnonzero(~seen).tolist() == [10]
    assert np.hypot(*(trajectory.positions - truth)[seen].T).max() < 1.5
    [remark] = result.remarks
    assert 'frame 10 is left out' in remark and remark in caplog.text


def test_a_recording_is_searched_apart_before_and_after_a_pause(recorded):
    frames, truth = moving_target(40)
    stamps = 0.04 * np.arange(40)
    stamps[20:] += 600
    result = recorded(frames, stamps, batch_length=20)
    assert result.n_batches == 2
    assert 'before and after pauses: 600 s before frame 20' in result.remarks[0]
    found = sum(np.isfinite(one.positions[:, 0]).astype(int) for one in result.trajectories)
    np.testing.assert_array_equal(found, 1)


def test_nanoseconds_are_searched_as_seconds(recorded):
    frames, _ = moving_target(20)
    result = recorded(frames, 40_000_000 * np.arange(20))
    assert result.trajectories[0].velocity[:, 0].mean() == pytest.approx(0.7 / 0.04, rel=0.1)
    assert result.remarks == ['stamps of a.npz are read as nanoseconds']


def test_a_recording_played_backwards_is_refused(recorded):
    with pytest.raises(tbd.DataError, match='stamps must increase'):
        recorded(moving_target(10)[0], -np.arange(10.0))


def test_time_unit_changes_nothing_but_the_velocity():
    frames, _ = moving_target(20)
    slow = tbd.detect(frames, **OPTIONS)
    fast = tbd.detect(frames, stamps=np.arange(20) / 50, **OPTIONS)
    np.testing.assert_allclose(slow.trajectories[0].positions, fast.trajectories[0].positions,
                               atol=1e-6)
    np.testing.assert_allclose(50 * slow.trajectories[0].velocity,
                               fast.trajectories[0].velocity, rtol=1e-6)


def test_a_target_of_some_frames_is_one_trajectory_in_these_frames():
    n_frames, seen = 200, slice(60, 140)
    frames = np.random.default_rng(4).standard_normal((n_frames, 32, 72)).astype(np.float32)
    with_target, truth = moving_target(80, amplitude=5.0, seed=9, shape=(32, 72))
    frames[seen] = with_target
    result = tbd.detect(frames, threshold=9.0, batch_length=20)
    [trajectory] = result.trajectories
    present = np.flatnonzero(np.isfinite(trajectory.positions[:, 0]))
    assert abs(present[0] - 60) <= 2 and abs(present[-1] - 139) <= 2
    inside = trajectory.positions[seen] - truth
    assert np.nanmax(np.hypot(*inside.T)) < 1.5
    for values in (trajectory.amplitudes, trajectory.velocity[:, 0]):
        np.testing.assert_array_equal(np.isfinite(values), np.isfinite(trajectory.positions[:, 0]))


def test_a_target_that_was_only_missed_keeps_its_frames():
    # Dimmer, it is found in the middle batches alone, and is there in all frames.
    frames, truth = moving_target(60, amplitude=6.0, seed=2)
    frames[:10] -= 0.8 * (frames[:10] - moving_target(60, amplitude=0.0, seed=2)[0][:10])
    [trajectory] = tbd.detect(frames, threshold=12.0, batch_length=20).trajectories
    assert np.isfinite(trajectory.positions[10:, 0]).all()


class _Recording:
    def __init__(self, frames, stamps):
        self.frames, self.stamps = frames, stamps

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


def test_a_pipeline_that_is_passed_gets_what_one_that_is_made_gets():
    frames, _ = moving_target(40)
    frames[5] = frames[4]
    stamps = 0.04 * np.arange(40)
    stamps[20:] += 600
    stamps[10] = 0.0
    options = DetectorOptions(**OPTIONS, batch_length=20)
    made, passed = (detect_recording(_Recording(frames, stamps), options, pipeline=pipeline)
                    for pipeline in (None, TrackingPipeline(options)))
    assert passed.remarks == made.remarks and len(made.remarks) == 3
    assert passed.n_batches == made.n_batches == 2


def test_batches_that_are_prepared_ahead_give_what_one_after_the_other_gives():
    frames, _ = moving_target(60)
    frames += 100 + 20 * np.random.default_rng(3).standard_normal(frames.shape[1:])
    options = {**OPTIONS, 'batch_length': 20, 'background': 'temporal_median', 'noise': 'robust'}
    ahead = tbd.detect(frames, **options)
    with at_most_cores(1):
        alone = tbd.detect(frames, **options)
    assert len(ahead.trajectories) == 1 and ahead.remarks == alone.remarks
    for one, other in zip(ahead.trajectories, alone.trajectories, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)


def test_a_batch_that_cannot_be_prepared_ends_the_search_of_its_recording():
    class Broken(_Recording):
        def __getitem__(self, index):
            if index == 30:
                raise OSError('frame 30 cannot be read')
            return super().__getitem__(index)

    frames, _ = moving_target(40)
    options = DetectorOptions(**OPTIONS, batch_length=10)
    with pytest.raises(OSError, match='frame 30'):
        detect_recording(Broken(frames, np.arange(40.0)), options)


def test_progress_of_a_recording_rises_from_batch_to_batch():
    rng = np.random.default_rng(0)
    frames = 2.2 * rng.standard_normal((40, 64, 64))
    told = []
    result = tbd.detect(frames, threshold=9.0, batch_length=20, hop=20, max_time_s=1.5,
                        progress=lambda *what: told.append(what))
    shares = [share for label, share in told if label == 'searching']
    assert shares == sorted(shares) and shares[-1] == 1
    assert any(0 < share < 0.5 for share in shares) and any(0.5 < share < 1 for share in shares)
    assert result.status == 'time_limit'


def test_the_worst_status_of_all_batches_is_that_of_the_recording():
    frames = np.random.default_rng(0).standard_normal((40, 32, 32))
    frames[20:] += 100.0
    result = tbd.detect(frames, threshold=9.0, batch_length=20, hop=20)
    assert result.status == 'not_noise' and result.n_batches == 2
    assert len(result.remarks) == 1


def test_the_best_statistic_below_the_threshold_is_told():
    frames = np.random.default_rng(0).standard_normal((10, 32, 32))
    high = tbd.detect(frames, threshold=9.0)
    assert high.trajectories == [] and 4 < high.best_statistic < 9
    # A path of the grid gains a little between the pixels.
    low = tbd.detect(frames, threshold=high.best_statistic - 1e-3)
    assert low.trajectories[0].statistic == pytest.approx(high.best_statistic, rel=0.05)


@pytest.mark.parametrize('continuation', [(1.0,), (0.0,), (1.0, 0.0)])
def test_a_bound_of_the_best_statistic_is_not_told_as_one(continuation):
    # The search of a path of constant amplitude in uneven noise stops where none can pass.
    rng = np.random.default_rng(0)
    result = tbd.detect(rng.standard_normal((10, 32, 32)), threshold=8.0,
                        amplitude_model='constant', continuation=continuation,
                        variance=rng.uniform(0.5, 2.0, (32, 32)))
    assert result.trajectories == [] and not result.best_statistic > 7.9


CLUTTER = {'calibration': 'clutter', 'amplitudes': 'signed', 'psf_sigma_px': 1.5,
           'batch_length': 10, 'hop': 5}


def fading_target(snr, seed=31):
    """Return noise with a target whose SNR is that of each frame, and its way."""
    snr = np.asarray(snr, float)
    frames = np.random.default_rng(seed).standard_normal((len(snr), 64, 72)).astype(np.float32)
    y, x = np.mgrid[:64, :72]
    way = np.array([14.0, 30.0]) + np.arange(len(snr))[:, None] * [0.8, 0.1]
    for frame, height, (cx, cy) in zip(frames, snr, way, strict=True):
        spot = np.exp(-((x - cx)**2 + (y - cy)**2) / 4.5)
        frame += height * spot / np.linalg.norm(spot)
    return frames, way


@pytest.mark.parametrize('snr', [
    [6] * 20 + [1.7] * 10 + [6] * 15,
    [6] * 20 + [1.7] * 10,
    [1.7] * 10 + [6] * 20])
def test_target_is_followed_through_batches_in_which_it_is_too_dim_to_be_found(snr):
    frames, way = fading_target(snr)
    dim = np.flatnonzero(np.array(snr) < 3)
    assert tbd.detect(frames[dim], **CLUTTER).trajectories == []
    [trajectory] = tbd.detect(frames, **CLUTTER).trajectories
    distance = np.hypot(*(trajectory.positions - way).T)
    assert np.isfinite(distance).all()
    assert np.median(distance[dim]) < 2


def test_a_candidate_that_carries_a_trajectory_on_is_not_rejected_as_well():
    frames, _ = fading_target([6] * 20 + [1.7] * 10)
    pipeline = TrackingPipeline(DetectorOptions.from_mapping(CLUTTER))
    for first in range(0, 25, 5):
        numbers = np.arange(first, first + 10)
        result = pipeline.process(FrameBatch(frames[numbers], numbers.astype(float), numbers))
        [trajectory] = result.trajectories
        assert all(one.positions is not trajectory.positions for one in result.rejected)


def test_trajectory_ends_where_no_candidate_is_near():
    frames, way = fading_target([6] * 20 + [0] * 30)
    [trajectory] = tbd.detect(frames, **CLUTTER).trajectories
    assert np.isnan(trajectory.positions[30:]).all()


def test_candidates_are_listed_with_their_reasons():
    frames, _ = fading_target([6] * 20)
    frames[12, 50, 50] += 60
    result = tbd.detect(frames, **CLUTTER)
    assert {one.reason for one in result.trajectories} == {''}
    assert all(one.reason and one.id == 0 for one in result.rejected)
    assert 'in one frame only' in {one.reason for one in result.rejected}
