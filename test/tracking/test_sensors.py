"""Several sensors find together, on one plane, what they see through maps of their own."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

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
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.viterbi_table import RowThreads
from track_before_detect.tracking.sensor_pipeline import SensorPipeline
from track_before_detect.tracking.sensors import SensorArray
from track_before_detect.types import FrameBatch

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
    view = array.measurement
    detector = ConvexDetector(DetectorOptions(amplitudes='signed'), view)
    measured = view.scores(detector.graph(array.stamps, view.shape), view.shape, detector.model,
                           RowThreads(grid_shape(view, view.shape)[0], 1))
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((6, len(array), *view.frame_shape(view.shape)), dtype=np.float32)
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


def test_two_sensors_find_what_neither_finds_alone():
    # Thresholds that 5 % of batches of noise pass: of both together, of the first, of the second.
    thresholds = (6.05, 5.4, 5.32)
    found = []
    for seed in range(8):
        pair = sensors(seed, 2.0, n_frames=5)
        found.append([any(np.abs(t.positions - place(t.stamps)).mean() < 1.5 for t in
                          detect_sensors(used, max_acceleration_px_s2=0, max_speed_px_s=1.0,
                                         threshold=threshold).trajectories)
                      for used, threshold in zip((pair, pair[:1], pair[1:]), thresholds,
                                                 strict=True)])
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


@pytest.mark.parametrize('steps', [{'noise': 'robust'}, {'background': 'spatial_median'}],
                         ids=['correlated noise', 'background mesh'])
def test_a_sensor_with_a_psf_of_its_own_is_prepared_by_it_whatever_the_options_say(steps):
    rng = np.random.default_rng(7)
    [seen, _] = sensors(7, 30.0, noise=0.0)
    noise = ndimage.gaussian_filter(rng.normal(size=seen.frames.shape), (0, 0.6, 0.6))
    y, x = np.mgrid[:SHAPES[0][0], :SHAPES[0][1]]
    frames = seen.frames + noise / noise.std() + 0.005 * ((y - 15)**2 + (x - 17)**2)
    sensor = Sensor(frames, seen.stamps, psf_sigma_px=SIGMAS[0])
    y, x = np.mgrid[-9:10, -9:10]
    statistics = []
    for psf in ({'psf': np.exp(-0.5 * (x**2 + y**2) / 3.0**2)}, {'psf_sigma_px': SIGMAS[0]}):
        [found] = detect_sensors([sensor], threshold=30, max_acceleration_px_s2=0, **psf,
                                 **steps).trajectories
        statistics.append(found.statistic)
    assert statistics[0] == pytest.approx(statistics[1], rel=1e-6)


def test_an_array_as_psf_counts_by_its_width_in_the_preparation():
    rng = np.random.default_rng(8)
    noise = ndimage.gaussian_filter(rng.normal(size=(N_FRAMES, 40, 40)), (0, 1, 1))
    y, x = np.mgrid[-8:9, -8:9]
    array = np.exp(-0.125 * (x**2 + y**2))
    frames = noise / noise.std()
    frames[:, 12:29, 12:29] += 40 * array / np.linalg.norm(array)
    statistics = []
    for psf in ({'psf': array}, {'psf_sigma_px': 2.0}):
        [found] = detect(frames, threshold=25, noise='robust', max_acceleration_px_s2=0,
                         **psf).trajectories
        statistics.append(found.statistic)
    assert statistics[0] == pytest.approx(statistics[1], rel=0.01)


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
    (lambda: [good(), good(frames=np.zeros((3, 9, 9), complex))], 'all hold real frames or'),
    (lambda: [good(), good(variance='x.csv')], 'sensor 1: variance must be a file'),
    (lambda: [good(stamps=[0, 1])], 'stamps of sensor 0'),
    (lambda: [good(stamps=[0, 2, 1])], 'increase, got 2 s and then 1 s at frame 2'),
    (lambda: [good(stamps=[0, np.nan, 1])], 'stamps of sensor 0 must be finite, got nan'),
    (lambda: [good(affine=np.eye(3))], 'shape'),
    (lambda: [good(affine=np.eye(3)[:, :2])], r'shape \(2, 3\), got float64 of shape \(3, 2\)'),
    (lambda: [good(affine=np.zeros((2, 3)))], 'invertible'),
    (lambda: [good(), good(affine=[[1, 0, 1e5], [0, 1, 0]])], 'near each other'),
    (lambda: [good(psf=np.ones((3, 3)), psf_sigma_px=1.0)], 'got both'),
    (lambda: [good(noise_sigma=0.0)], 'noise_sigma'),
    (lambda: [good(noise_sigma='one')], "noise_sigma of sensor 0 must be a number, got 'one'"),
    (lambda: [good(noise_sigma=True)], 'noise_sigma of sensor 0 must be a number, got True'),
    (lambda: [good(psf_sigma_px='one')], 'sensor 0: psf_sigma_px must be a number'),
    (lambda: [good(psf_sigma_px=True)], 'sensor 0: psf_sigma_px must be a number, got True'),
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
    ({'exposure_s': 0.1}, 'exposure_s'),
    ({'variance': np.ones((9, 9))}, 'variance'),
    ({'motion_model': 'range_doppler', 'range_bins_per_doppler_bin': 1.0}, 'motion_model'),
    ({'motion_model': 'range_bearing'}, 'motion_model'),
])
def test_options_that_several_sensors_cannot_honour_are_refused(options, words):
    with pytest.raises(ParameterError, match=f'several sensors cannot honour {words}='):
        detect_sensors([good(), good()], **options)


def test_a_target_that_enters_late_is_found_by_two_sensors():
    pair = sensors(4, 6.0)
    for sensor in pair:
        rng = np.random.default_rng(6)
        sensor.frames[:4] = sensor.noise_sigma * rng.standard_normal(sensor.frames[:4].shape)
    [found] = detect_sensors(pair, threshold=9, presence='partial').trajectories
    present = np.isfinite(found.positions[:, 0])
    assert not present[:6].any() and present[9:].all()
    np.testing.assert_allclose(found.positions[present], place(found.stamps)[present], atol=1.0)


def test_complex_frames_of_two_sensors_are_searched_together():
    rng = np.random.default_rng(8)
    pair = []
    for sensor in sensors(5, 6.0, noise=0.0):
        noise = (rng.standard_normal((*sensor.frames.shape, 2)) @ [1, 1j]) * 0.5**0.5
        phases = np.exp(2j * np.pi * rng.uniform(size=(N_FRAMES, 1, 1)))
        pair.append(dataclasses.replace(
            sensor, frames=sensor.frames * phases + sensor.noise_sigma * noise))
    [found] = detect_sensors(pair, threshold=9, amplitudes='complex').trajectories
    np.testing.assert_allclose(found.positions, place(found.stamps), atol=1.0)
    assert np.iscomplexobj(found.amplitudes)
    np.testing.assert_allclose(np.abs(found.amplitudes[::2]).mean(), 6, rtol=0.2)


def test_variance_and_mask_of_a_sensor_are_those_of_its_own_pixels():
    first, second = sensors(6, 6.0)
    noisy = np.ones(SHAPES[0])
    noisy[:, 20:] = 25.0
    rng = np.random.default_rng(9)
    louder = first.frames + rng.standard_normal(first.frames.shape) * np.sqrt(noisy - 1)
    dead = np.zeros((N_FRAMES, *SHAPES[1]), bool)
    dead[:, 5, 5] = True
    broken = second.frames.copy()
    broken[:, 5, 5] = 1e6
    told = [dataclasses.replace(first, frames=louder, variance=noisy),
            dataclasses.replace(second, frames=broken, mask=dead)]
    [found] = detect_sensors(told, threshold=9).trajectories
    np.testing.assert_allclose(found.positions, place(found.stamps), atol=1.0)
    untold = detect_sensors([dataclasses.replace(told[0], variance=None), second],
                            threshold=9, max_speed_px_s=0.1)
    assert any(np.nanmin(t.positions[:, 0]) > 20 for t in untold.trajectories)


def test_a_variance_of_another_shape_names_what_was_expected():
    first, second = sensors(6, 6.0)
    with pytest.raises(DataError, match='variance must have the shape'):
        detect_sensors([first, dataclasses.replace(second, variance=np.ones((3, 3)))],
                       threshold=9)


def test_one_with_too_few_frames_for_its_background_is_left_out_in_words():
    [whole, other] = sensors(2, 6.0)
    short = dataclasses.replace(other, frames=other.frames[:2], stamps=other.stamps[:2])
    told = {'threshold': 9, 'background': 'temporal_median', 'noise': 'robust'}
    alone = detect_sensors([whole], **told)
    both = detect_sensors([whole, short], **told)
    assert 'sensor 1: background=temporal_median needs at least 3 frames, got 2; its' in str(
        both.remarks)
    [a], [b] = alone.trajectories, both.trajectories
    assert a.statistic == pytest.approx(b.statistic, rel=0.02)
    with pytest.raises(DataError, match='at least 3 frames, got 2'):
        detect_sensors([short], **told)


def test_batches_with_jitter_or_other_shares_of_the_sensors_share_a_calibration():
    rng = np.random.default_rng(0)
    small = [Sensor(rng.standard_normal((12, 9, 9)), np.sort(rng.uniform(0, 12, 12)))
             for _ in range(2)]
    told = DetectorOptions(motion_model='static', batch_length=6)
    array = SensorArray(small, told)
    pipeline = SensorPipeline(array.plane, told)
    found = [pipeline.process(FrameBatch(
        np.stack([array[i] for i in range(first, first + 6)]), 0.5 * np.arange(6), np.arange(6),
        taken=array.taken[first:first + 6])) for first in (0, 6, 12)]
    assert len({tuple(array.taken[first:first + 6, 0]) for first in (0, 6, 12)}) == 3
    assert len({result.threshold for result in found}) == 1
