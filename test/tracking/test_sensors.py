"""Several sensors find together, on one plane, what they see through maps of their own."""

import numpy as np
import pytest

from track_before_detect import (
    DataError,
    detect,
    detect_sensors,
    geometry,
    ParameterError,
    Sensor,
)
from track_before_detect.models.measurement.base import grid_shape
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration import threshold
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.viterbi_table import RowThreads
from track_before_detect.tracking.sensors import SensorArray

TURN, ZOOM = np.deg2rad(25), 1.25
AFFINES = (
    np.array([[1.0, 0, 0], [0, 1, 0]]),
    np.array([[ZOOM * np.cos(TURN), -ZOOM * np.sin(TURN), 14],
              [ZOOM * np.sin(TURN), ZOOM * np.cos(TURN), -6]]),
)
SHAPES = ((30, 34), (26, 28))
SIGMAS = (1.0, 0.9)
NOISES = (1.0, 20.0)
N_FRAMES = 10


def place(stamps):
    """Return where the target is on the plane, (T, 2)."""
    return np.array([14.0, 12.0]) + np.outer(stamps, [0.7, 0.5])


def sensors(seed, snr, later_s=0.37, noise=1.0, n_frames=N_FRAMES):
    """Return two sensors that look at one target, and see it at this SNR."""
    rng = np.random.default_rng(seed)
    made = []
    for number, affine in enumerate(AFFINES):
        stamps = np.arange(n_frames) + number * later_s
        back = np.linalg.inv(np.vstack([affine, [0, 0, 1]]))
        y, x = np.mgrid[:SHAPES[number][0], :SHAPES[number][1]]
        frames = noise * rng.normal(size=(n_frames, *SHAPES[number]))
        for frame, position in zip(frames, place(stamps), strict=True):
            at = back @ np.append(position, 1)
            picture = np.exp(-0.5 * ((x - at[0])**2 + (y - at[1])**2) / SIGMAS[number]**2)
            frame += snr * picture / np.linalg.norm(picture)
        made.append(Sensor(frames * NOISES[number], stamps, affine, SIGMAS[number],
                           noise_sigma=NOISES[number]))
    return made


@pytest.mark.parametrize('later_s', [0.37, 0.0], ids=['interleaved', 'at once'])
@pytest.mark.parametrize('detector', ['convex', 'greedy'])
def test_a_target_without_noise_is_recovered_on_the_plane(later_s, detector):
    result = detect_sensors(sensors(0, 5.0, later_s, noise=0.0), detector, threshold=9)
    [found] = result.trajectories
    exact = 0.005 if detector == 'convex' else 1.0
    np.testing.assert_allclose(found.positions, place(found.stamps), atol=exact)
    if detector == 'convex':
        np.testing.assert_allclose(found.velocity, np.tile([0.7, 0.5], (20, 1)), atol=0.01)
        assert found.statistic == pytest.approx(5 * np.sqrt(2 * N_FRAMES), rel=1e-4)
        first = found.amplitudes[::2]
        np.testing.assert_allclose(first, 5 * NOISES[0], rtol=1e-3)
        np.testing.assert_allclose(found.amplitudes[1::2], 5 * NOISES[1], rtol=1e-3)
    assert len(found.stamps) == 2 * N_FRAMES and np.all(np.diff(found.stamps) >= 0)


def test_one_sensor_as_the_plane_finds_what_the_plain_call_finds():
    [sensor, _] = sensors(3, 5.0)
    alone = detect_sensors([sensor], threshold=9, max_acceleration_px_s2=0)
    plain = detect(sensor.frames, threshold=9, max_acceleration_px_s2=0)
    assert len(alone.trajectories) == len(plain.trajectories) == 1
    a, b = alone.trajectories[0], plain.trajectories[0]
    assert a.statistic == pytest.approx(b.statistic, rel=1e-4)
    np.testing.assert_allclose(a.positions, b.positions, atol=0.01)
    np.testing.assert_allclose(a.amplitudes, b.amplitudes, rtol=1e-3)


def test_statistics_of_noise_have_unit_variance_through_the_maps():
    array = SensorArray(sensors(0, 0.0), DetectorOptions(amplitudes='signed'))
    view = array.view(np.arange(len(array)))
    detector = ConvexDetector(DetectorOptions(amplitudes='signed'), view)
    measured = view.scores(detector.graph(array.stamps, view.shape), view.shape, detector.model,
                           RowThreads(grid_shape(view, view.shape)[0], 1))
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((6, len(array), *view.frame_shape), dtype=np.float32)
    scores = np.array([measured.scores(frames) for frames in noise])
    y, x = np.mgrid[:scores.shape[2], :scores.shape[3]] / view.oversampling
    for sensor, (height, width) in enumerate(SHAPES):
        own = scores[:, view.sensor == sensor]
        matrix = view.maps[view.sensor == sensor][0]
        at = geometry.apply(matrix, np.stack([x, y], axis=-1))
        inside = np.min([at[..., 0], at[..., 1], width - 1 - at[..., 0], height - 1 - at[..., 1]],
                        axis=0)
        # In the middle and at borders, where the stamp is cut.
        for low, high in ((4, 99), (-1, 2)):
            assert own[:, :, (inside > low) & (inside < high)].mean() == pytest.approx(1, abs=0.04)
        assert not own[:, :, inside < -5].any()


def test_two_sensors_find_what_neither_finds_alone(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(threshold, 'MOST_CROPS', 100)
    found = []
    for seed in range(8):
        pair = sensors(seed, 2.0, n_frames=5)
        found.append([any(np.abs(t.positions - place(t.stamps)).mean() < 1.5 for t in
                          detect_sensors(used, max_acceleration_px_s2=0, max_speed_px_s=1.0,
                                         false_alarm_rate=0.05).trajectories)
                      for used in (pair, pair[:1], pair[1:])])
    found = np.array(found)
    # Expected are 7 or 8 scenes, and 4 for either sensor alone.
    assert found[:, 0].sum() >= 6
    assert found[:, 1].sum() <= 6 and found[:, 2].sum() <= 6
    assert np.any(found[:, 0] & ~found[:, 1] & ~found[:, 2])


def test_overlapping_batches_keep_one_identity():
    result = detect_sensors(sensors(1, 6.0), threshold=9, batch_length=12, hop=6)
    assert result.n_batches > 1
    [found] = result.trajectories
    assert np.isfinite(found.positions).all()
    np.testing.assert_allclose(found.positions, place(found.stamps), atol=1.0)


def test_a_target_outside_the_view_of_a_sensor_has_no_amplitude_there():
    [whole, _] = sensors(2, 6.0)
    part = Sensor(whole.frames[:, :, 18:], np.arange(N_FRAMES) + 0.5, [[1, 0, 18], [0, 1, 0]], 1.0)
    [found] = detect_sensors([whole, part], threshold=9).trajectories
    seen = np.isfinite(found.amplitudes)
    assert seen[::2].all()
    np.testing.assert_array_equal(seen[1::2], place(found.stamps)[1::2, 0] > 17.5)


def test_background_and_noise_are_those_of_each_sensor():
    pair = sensors(4, 6.0)
    rng = np.random.default_rng(0)
    shaded = [Sensor(sensor.frames + rng.uniform(0, 500, sensor.frames.shape[1:]), sensor.stamps,
                     sensor.affine, sensor.psf_sigma_px) for sensor in pair]
    result = detect_sensors(shaded, background='temporal_median', noise='robust', threshold=10)
    [found] = result.trajectories
    assert np.abs(found.positions - place(found.stamps)).mean() < 0.5


def test_masked_pixels_are_left_out():
    pair = sensors(6, 6.0)
    for sensor in pair:
        sensor.frames[np.random.default_rng(1).random(sensor.frames.shape) < 0.1] = np.nan
    [found] = detect_sensors(pair, threshold=9).trajectories
    assert np.abs(found.positions - place(found.stamps)).mean() < 0.5


def test_a_blind_sensor_leaves_the_search_to_the_others():
    first, second = sensors(6, 20.0)
    first.frames[:] = np.nan
    [found] = detect_sensors([first, second], threshold=12).trajectories
    assert np.abs(found.positions - place(found.stamps)).mean() < 0.5
    assert np.isfinite(found.amplitudes).sum() == len(second.stamps)


def good(**changes):
    return Sensor(**{'frames': np.zeros((3, 9, 9)), 'stamps': np.arange(3.0), **changes})


@pytest.mark.parametrize(('made', 'words'), [
    (lambda: [], 'at least one'),
    (lambda: [good(frames=np.zeros((9, 9)))], 'frames of sensor 0'),
    (lambda: [good(), good(frames=np.zeros((3, 9, 9), complex))], 'sensor 1 must hold real'),
    (lambda: [good(stamps=[0, 1])], 'stamps of sensor 0'),
    (lambda: [good(stamps=[0, 2, 1])], 'increase, got 2 s and then 1 s at frame 2'),
    (lambda: [good(stamps=[0, np.nan, 1])], 'stamps of sensor 0 must be finite, got nan'),
    (lambda: [good(affine=np.eye(3))], 'shape'),
    (lambda: [good(affine=np.eye(3)[:, :2])], r'shape \(2, 3\), got float64 of shape \(3, 2\)'),
    (lambda: [good(affine=np.zeros((2, 3)))], 'invertible'),
    (lambda: [good(), good(affine=[[1, 0, 1e5], [0, 1, 0]])], 'near each other'),
    (lambda: [good(psf=np.ones((3, 3)), psf_sigma_px=1.0)], 'got both'),
    (lambda: [good(noise_sigma=0.0)], 'noise_sigma'),
    (lambda: [good(noise_sigma='one')], "noise_sigma of sensor 0 must be .* above 0, got 'one'"),
    (lambda: [good(noise_sigma=True)], 'noise_sigma of sensor 0 must be .* above 0, got True'),
    (lambda: [good(psf_sigma_px='one')], 'psf_sigma_px of sensor 0 must be a number'),
    (lambda: [good(psf_sigma_px=True)], 'psf_sigma_px of sensor 0 must be a number, got True'),
    (lambda: [good(), good(psf_sigma_px=0.1)], 'sensor 1: sigma_px must be at least 0.2 px'),
    (lambda: [good(), good(psf=np.ones((2, 3)))], 'sensor 1: psf must be a 2-D array'),
    (lambda: [good(), good(affine=[[1, 0, 1e30], [0, 1, 0]])], 'near each other'),
    (lambda: [good(affine=1j * np.eye(2, 3))], 'affine of sensor 0 must be real numbers'),
    (lambda: [good(stamps=1j * np.arange(3))], 'stamps of sensor 0 must be real numbers'),
    (lambda: good(), 'must be a list of Sensor, got Sensor'),
    (lambda: [np.zeros((3, 9, 9))], 'must be a list of Sensor, got ndarray at 0'),
    (lambda: [good(frames=np.full((3, 9, 9), np.nan))], 'no pixel of the 3 frames is finite'),
])
def test_sensors_that_cannot_be_used_are_refused_in_one_sentence(made, words):
    with pytest.raises((DataError, ParameterError), match=words):
        detect_sensors(made(), threshold=8)


@pytest.mark.parametrize(('options', 'words'), [
    ({'detector': 'mff_dp'}, 'detector'),
    ({'registration': 'affine'}, 'registration'),
    ({'amplitude_model': 'constant'}, 'amplitude_model'),
    ({'presence': 'partial'}, 'presence'),
    ({'amplitudes': 'complex'}, 'amplitudes'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0}, 'motion_model'),
    ({'motion_model': 'range_bearing'}, 'motion_model'),
])
def test_options_that_several_sensors_cannot_honour_are_refused(options, words):
    with pytest.raises(ParameterError, match=f'{words} must'):
        detect_sensors([good(), good()], **options)
