"""Target cancellation and its parallel form on the scenes of Guo et al. 2018."""

import numpy as np
import pytest

from false_alarms import assert_rate_is_realised
from naive import gaussian_stamp_image
import track_before_detect as tbd
from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.studies.parallel import scenes
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.models.motion.transition_sets import directional_sets
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.cancellation import target_cancellation
from track_before_detect.solvers.cancellation.mt_dp import MtDpDetector
from track_before_detect.solvers.cancellation.pc_dp import PcDpDetector
from track_before_detect.solvers.cancellation.target_cancellation import TargetSearch
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure, Merit
from track_before_detect.types import FrameBatch

DETECTORS = [pytest.param(MtDpDetector, id='mt_dp'), pytest.param(PcDpDetector, id='pc_dp')]
NARROW = GaussianPsf(0.3)
STAMPS = np.arange(6.0)


def search(frames, psf=NARROW, squared=True):
    return TargetSearch(measure(frames, psf), exclusion_levels(psf), Merit(squared))


@pytest.mark.parametrize('n_directions', [1, 2, 3, 4, 6])
@pytest.mark.parametrize('squared', [True, False])
def test_bright_targets_of_the_paper_are_all_found_in_their_cells(n_directions, squared):
    scene = scenes.six_targets(20.0, np.random.default_rng(1))
    made = search(scene.frames, squared=squared)
    directions = directional_sets([1] * 6, n_directions)
    bound = 60.0 if squared else 20.0
    searches = made.run_parallel(directions, bound, 1)
    found = made.fuse(searches, bound)
    last = {tuple(track.pixels[-1]) for track in found[:6]}
    assert last == {tuple(cells[-1]) for cells in scene.cells}


@pytest.mark.parametrize('detector', DETECTORS)
def test_searches_over_other_transitions_have_calibrations_of_their_own(detector):
    made = detector(DetectorOptions(
        detector={MtDpDetector: 'mt_dp', PcDpDetector: 'pc_dp'}[detector], max_speed_px_s=1.0))
    often, once = np.array([0.0, 2.0, 4.0, 5.0]), np.array([0.0, 1.0, 2.0, 4.0])
    # The largest steps are the same.
    assert made.noise_study(often, (32, 32)).key != made.noise_study(once, (32, 32)).key


def test_threads_change_nothing(monkeypatch):
    monkeypatch.setattr(target_cancellation, 'LEAST_FOR_THREADS', 0)
    scene = scenes.six_targets(9.0, np.random.default_rng(2))
    made = search(scene.frames)
    directions = directional_sets([1] * 6, 4)
    alone, together = (made.run_parallel(directions, 25.0, n) for n in (1, 4))
    for a, b in zip(alone, together, strict=True):
        assert a.n_candidates == b.n_candidates
        assert [track.value for track in a.tracks] == [track.value for track in b.tracks]
        assert all(np.array_equal(p.pixels, q.pixels)
                   for p, q in zip(a.tracks, b.tracks, strict=True))


def test_found_points_leave_nothing_behind():
    frames = np.zeros((6, 20, 20), complex)
    for t in range(6):
        frames[t, 5 + t, 7] = 30j
    done = search(frames).run(directional_sets([1] * 6, 1)[0], 1.0)
    assert len(done.tracks) == 1 and done.largest_left == 0
    np.testing.assert_allclose(done.tracks[0].seen, 30j)


def test_a_search_in_a_wrong_direction_adds_no_track_of_its_own():
    scene = scenes.draw_scene([(10.0, 1.0, 10.0, 1.0)], 18.0, np.random.default_rng(4))
    made = search(scene.frames)
    searches = made.run_parallel(directional_sets([1] * 6, 4), 33.0, 1)
    assert sum(len(done.tracks) for done in searches) > 1
    [track] = made.fuse(searches, 33.0)
    np.testing.assert_array_equal(track.pixels, scene.cells[0])


def test_targets_of_all_directions_are_found():
    for angle in range(8):
        step = np.rint([np.cos(angle * np.pi / 4), np.sin(angle * np.pi / 4)])
        scene = scenes.draw_scene([(25.0, step[0], 25.0, step[1])], 15.0,
                                  np.random.default_rng(angle))
        made = search(scene.frames)
        found = made.fuse(made.run_parallel(directional_sets([1] * 6, 8), 40.0, 1), 40.0)
        np.testing.assert_array_equal(found[0].pixels, scene.cells[0])


@pytest.mark.parametrize('detector', DETECTORS)
@pytest.mark.parametrize('snr', [4.0, 30.0])
def test_blurred_targets_are_found_once_each(detector, snr):
    made = simulate('three_targets', 3, snr=snr, fps=1.0)
    options = DetectorOptions(threshold=12.0, max_speed_px_s=1.0)
    found = detector(options).detect(FrameBatch.of(made.frames, made.stamps)).found
    truth = made.truth[:, 2:].reshape(3, 20, 2)
    errors = [min(np.hypot(*(trajectory.positions - path).T).mean() for path in truth)
              for trajectory in found]
    assert len(found) == 3
    assert max(errors) < 1.5


@pytest.mark.parametrize('detector', DETECTORS)
def test_noisy_pixels_carry_less_weight(detector):
    made = simulate('single_target', 5, snr=8.0, fps=1.0)
    deviation = np.where(np.arange(128) % 7 == 3, 5.0, 1.0)
    weights = np.broadcast_to(1 / deviation, (1, 128, 128)).astype(np.float32)
    noise = np.random.default_rng(6).standard_normal(made.frames.shape, np.float32)
    clean = made.frames - simulate('single_target', 5, snr=0.0, fps=1.0).frames
    options = DetectorOptions(threshold=11.0, max_speed_px_s=1.0)
    [found] = detector(options).detect(FrameBatch.of(clean * weights + noise, made.stamps),
                                                weights).found
    assert np.hypot(*(found.positions - made.truth[:, 2:]).T).mean() < 1
    assert np.median(found.amplitudes) == pytest.approx(8.0, abs=1.5)


@pytest.mark.parametrize('detector', DETECTORS)
def test_masked_pixels_are_not_searched(detector):
    made = simulate('single_target', 5, snr=6.0, fps=1.0)
    made.frames[:, :, 70:] = np.nan
    made.frames[4, 20:60] = np.nan
    options = DetectorOptions(threshold=9.5, max_speed_px_s=1.0)
    for trajectory in detector(options).detect(FrameBatch.of(made.frames, made.stamps)).found:
        assert np.all(trajectory.positions[:, 0] < 74)
        assert np.all(np.isfinite(trajectory.amplitudes))


@pytest.mark.parametrize('detector', DETECTORS)
def test_threshold_holds_the_false_alarm_rate_asked_for(detector, calibrate_on):
    calibrate_on(400)
    options = DetectorOptions(psf_sigma_px=0.3, max_speed_px_s=1.0, false_alarm_rate=0.1)
    made = detector(options)
    threshold = made.threshold(STAMPS, (50, 50))
    rng = np.random.default_rng(8)
    n_runs = 400
    alarms = sum(bool(made.detect(FrameBatch.of(rng.standard_normal((6, 50, 50)), STAMPS)).found)
                 for _ in range(n_runs))
    assert threshold == made.threshold(STAMPS, (50, 50))
    # Four standard deviations of the count and of the threshold about the rate.
    assert 0.03 < alarms / n_runs < 0.18


@pytest.mark.parametrize('name', ['mt_dp', 'pc_dp'])
def test_targets_of_complex_frames_are_found_by_name(name):
    for seed in range(5):
        scene = scenes.draw_scene([(12.0, 0.9, 30.0, -0.8), (35.0, -0.5, 10.0, 0.6)], 13.0,
                                  np.random.default_rng(seed))
        found = tbd.detect(scene.frames, detector=name, threshold=6.5,
                           **scenes.OPTIONS).trajectories
        assert len(found) == 2
        for cells in scene.cells:
            [trajectory] = [one for one in found
                            if np.abs(one.positions - cells).mean() < 1.0]
            truth = scene.frames[np.arange(6), cells[:, 1], cells[:, 0]]
            same = (trajectory.positions == cells).all(axis=1)
            np.testing.assert_allclose(trajectory.amplitudes[same], truth[same], rtol=1e-3)
        # A common turn of all phases turns the amplitudes and nothing else.
        turned = tbd.detect(1j * scene.frames, detector=name, threshold=6.5, **scenes.OPTIONS)
        for one, other in zip(found, turned.trajectories, strict=True):
            np.testing.assert_array_equal(one.positions, other.positions)
            np.testing.assert_allclose(1j * one.amplitudes, other.amplitudes, rtol=1e-4)


@pytest.mark.parametrize('name', ['mt_dp', 'pc_dp'])
def test_complex_noise_realises_the_false_alarm_rate_asked_for_by_name(name, calibrate_on):
    calibrate_on(400)
    rate = 0.2

    def passes(generator):
        noise = noise_frames(generator, (6, 50, 50), True)
        return bool(tbd.detect(noise, detector=name, false_alarm_rate=rate,
                               **scenes.OPTIONS).trajectories)

    assert_rate_is_realised(passes, rate, 200, 9)


@pytest.mark.parametrize('name', ['mt_dp', 'pc_dp'])
def test_target_of_complex_frames_is_followed_through_batches(name):
    generator = np.random.default_rng(3)
    frames = noise_frames(generator, (24, 40, 40), True)
    path = np.array([10.0, 30.0]) + np.arange(24)[:, None] * (0.8, -0.6)
    for frame, (x, y) in zip(frames, path, strict=True):
        frame += 9.0 * np.exp(2j * np.pi * generator.random()) * gaussian_stamp_image(
            frame.shape, x, y, 1.0)
    [trajectory] = tbd.detect(frames, detector=name, amplitudes='complex', threshold=14.0,
                              batch_length=10).trajectories
    assert np.hypot(*(trajectory.positions - path).T).mean() < 1.0
    assert np.mean(np.abs(trajectory.amplitudes)) == pytest.approx(8.5, abs=1.0)


@pytest.mark.parametrize('name', ['mt_dp', 'pc_dp'])
@pytest.mark.parametrize(('option', 'said'), [
    ({'motion_model': 'constant_velocity'}, 'motion_model=constant_velocity, only .* or static'),
    ({'presence': 'partial'}, 'presence=partial, only full'),
    ({'max_acceleration_px_s2': 0.1}, 'max_acceleration_px_s2=0.1, only automatic')])
def test_what_a_method_cannot_do_is_refused(name, option, said):
    options = DetectorOptions(detector=name, **option)
    with pytest.raises(ParameterError, match=f'{name} .*{said}'):
        {'mt_dp': MtDpDetector, 'pc_dp': PcDpDetector}[name](options)


@pytest.mark.parametrize(('asked', 'searched'), [(None, 4), (1, 1), (3, 3), (8, 4)])
def test_number_of_directions_is_an_option(asked, searched):
    # At one pixel per frame no more than the four quadrants differ.
    made = PcDpDetector(DetectorOptions(detector='pc_dp', max_speed_px_s=1.0, directions=asked))
    assert len(made.transition_sets(STAMPS)) == searched


def test_directions_are_refused_where_there_are_none():
    with pytest.raises(ParameterError, match='mt_dp cannot honour directions=2, .* only pc_dp'):
        MtDpDetector(DetectorOptions(detector='mt_dp', directions=2))


def test_psi_and_phi_are_sums_over_the_stamp():
    rng = np.random.default_rng(9)
    frames = rng.standard_normal((2, 12, 14))
    frames[1, 4:7, 3:9] = np.nan
    psf = ArrayPsf(rng.uniform(0.2, 1.0, (5, 3)))
    data = measure(frames, psf)
    half = len(data.stamp) // 2
    assert np.linalg.norm(data.stamp) == pytest.approx(1, abs=1e-5)
    valid = np.pad(np.isfinite(frames), ((0, 0), (half, half), (half, half)))
    clean = np.pad(np.nan_to_num(frames), ((0, 0), (half, half), (half, half)))
    for t, y, x in [(0, 0, 0), (0, 6, 7), (1, 5, 5), (1, 11, 13), (1, 2, 3)]:
        part = np.s_[t, y:y + 2 * half + 1, x:x + 2 * half + 1]
        assert data.psi[0, t, y, x] == pytest.approx(np.sum(clean[part] * data.stamp), abs=1e-4)
        assert data.phi[t, y, x] == pytest.approx(np.sum(valid[part] * data.stamp**2), abs=1e-4)
