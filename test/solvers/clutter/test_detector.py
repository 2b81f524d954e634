"""What stands out from the clutter is found, and clutter is not, as rarely as asked."""

import numpy as np
import pytest

from scenes.residuals import add_target, residual
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.clutter.detector import BELOW, ClutterDetector
from track_before_detect.solvers.clutter.reasons import SHADOW
from track_before_detect.types import FrameBatch

OPTIONS = {'calibration': 'clutter', 'amplitudes': 'signed', 'psf_sigma_px': 1.5}
KINDS = ('noise', 'fixed_blobs', 'k_distributed', 'codec_blocks')


def clutter(kind, *seed, shape=(8, 64, 64)):
    return residual(kind, np.random.default_rng(seed), shape)


def searched(frames, **options):
    detector = ClutterDetector(DetectorOptions(**{**OPTIONS, **options}))
    return detector.detect(FrameBatch.of(frames, np.arange(float(len(frames)))))


def follows(trajectory, way):
    return np.median(np.hypot(*(trajectory.positions - way).T)) < 1.0


# In other draws 2.2 % pass where 5 % is asked (docs/constants/clutter.md): among so few places
# clutter is allowed for that there may be.
@pytest.mark.parametrize(('rate', 'n_batches'), [(0.05, 200), (0.2, 100)])
def test_clutter_passes_as_rarely_as_asked(rate, n_batches):
    detector = ClutterDetector(DetectorOptions(**OPTIONS, false_alarm_rate=rate))
    passed = 0
    for k in range(n_batches):
        frames = clutter(KINDS[k % len(KINDS)], 17, k, shape=(8, 48, 48))
        passed += bool(detector.detect(FrameBatch.of(frames, np.arange(8.0))).found)
    assert rate / 10 <= passed / n_batches <= 2 * rate


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('sign', [1, -1])
def test_bright_and_dark_targets_stand_out(kind, sign):
    frames = clutter(kind, 2, shape=(10, 96, 80))
    way = add_target(frames, sign * 8.0, (25.3, 40.0), (1.4, -0.6))
    # Clutter may come with it, as rarely as asked, but it stands out most.
    found, *others = searched(frames).found
    assert follows(found, way)
    assert not any(follows(other, way) for other in others)
    assert found.statistic > 1
    assert found.reason == ''
    assert np.all(sign * np.median(found.amplitudes) > 0)


def test_not_being_told_whether_a_target_is_bright_or_dark_costs_little():
    """Bright and dark frames of one path would add up to more noise."""
    shares = []
    for k in range(8):
        frames = clutter('noise', 31, k, shape=(16, 96, 96))
        add_target(frames, 4.0, (20.0, 30.0), (1.3, 0.9))
        told, untold = (searched(frames, **amplitudes).found[0].statistic
                        for amplitudes in ({'amplitudes': 'non-negative'}, {}))
        shares.append(untold / told)
    assert np.mean(shares) > 0.97


@pytest.mark.parametrize('sign', [1, -1])
def test_target_that_is_dark_among_bright_ones_is_found(sign):
    frames = clutter('k_distributed', 8, shape=(10, 96, 96))
    ways = [add_target(frames, sign * snr, start, step) for snr, start, step in (
        (60.0, (30, 30), (1, 0)), (-8.0, (60, 60), (0, -1)), (9.0, (20, 75), (0.5, 0)))]
    found = searched(frames).found
    assert [[follows(one, way) for one in found].count(True) for way in ways] == [1, 1, 1]


def test_target_of_six_deviations_is_found_in_most_clutter():
    found = 0
    for k in range(12):
        frames = clutter(KINDS[k % len(KINDS)], 23, k)
        way = add_target(frames, 6.0, (20.0, 24.5), (1.3, 0.9))
        found += any(follows(one, way) for one in searched(frames).found)
    assert found >= 11


@pytest.mark.parametrize('n_targets', [1, 2, 3, 4])
def test_each_of_several_targets_is_one_trajectory(n_targets):
    frames = clutter('k_distributed', 3, n_targets, shape=(10, 96, 96))
    places = [((20, 20), (1, 0.5)), ((75, 20), (-0.5, 1)), ((20, 75), (0.7, -0.7)),
              ((75, 75), (0, -1.2))]
    ways = [add_target(frames, 8.0, *place) for place in places[:n_targets]]
    found = searched(frames).found
    assert len(found) == n_targets
    assert all(sum(follows(one, way) for one in found) == 1 for way in ways)


def test_dim_target_is_found_beside_a_bright_one():
    frames = clutter('k_distributed', 4, shape=(10, 96, 96))
    ways = [add_target(frames, 300.0, (30, 30), (1, 0)),
            add_target(frames, 8.0, (60, 60), (0, -1))]
    bright, dim = searched(frames).found
    assert follows(bright, ways[0])
    assert follows(dim, ways[1])
    assert bright.statistic > 10 * dim.statistic


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize(('distance_px', 'n_found'), [(11.0, 1), (30.0, 2)])
def test_what_runs_beside_a_stronger_one_of_the_other_sign_is_its_shadow(
        sign, distance_px, n_found):
    frames = clutter('k_distributed', 6, shape=(10, 96, 96))
    way = add_target(frames, sign * 40.0, (30, 30), (1, 0.5))
    shadow = add_target(frames, -sign * 9.0, (30, 30 + distance_px), (1, 0.5))
    result = searched(frames)
    assert len(result.found) == n_found
    assert follows(result.found[0], way)
    shadows = [one for one in result.rejected if one.reason == SHADOW]
    assert [follows(one, shadow) for one in shadows] == [True] * (2 - n_found)


@pytest.mark.parametrize('snr', [15.0, 60.0, 300.0])
def test_wide_target_is_one_trajectory(snr):
    frames = clutter('k_distributed', 5, shape=(10, 96, 96))
    way = add_target(frames, snr, (35, 50), (1.1, -0.4), sigma=3.0)
    [found] = searched(frames).found
    assert follows(found, way)


def test_what_lives_in_one_frame_is_rejected_with_the_reason():
    frames = clutter('codec_blocks', 6)
    add_target(frames[4:5], 60.0, (30, 30), (0, 0))
    result = searched(frames)
    assert result.found == []
    [flash] = [one for one in result.rejected if one.reason != BELOW]
    assert flash.reason == 'in one frame only'
    np.testing.assert_allclose(flash.positions[4], (30, 30), atol=1.5)


@pytest.mark.parametrize('start', [(2.0, 20.0), (61.0, 20.0), (30.0, 1.0), (30.0, 62.0)])
def test_what_lies_on_the_border_is_rejected_with_the_reason(start):
    frames = clutter('codec_blocks', 7)
    step = (0, 1) if start[0] != 30 else (1, 0)
    add_target(frames, 20.0, start, step)
    result = searched(frames)
    assert result.found == []
    [edge] = [one for one in result.rejected if one.reason != BELOW]
    assert edge.reason == 'on the border of the frames'


def test_statistics_are_in_units_of_the_threshold():
    frames = clutter('codec_blocks', 8)
    add_target(frames, 10.0, (20, 30), (1.5, 0))
    result = searched(frames)
    assert result.threshold == 1.0
    assert result.found[0].statistic > 1
    below = [one.statistic for one in result.rejected if one.reason == BELOW]
    assert below
    assert max(below) <= 1


def test_target_is_found_on_a_line_of_pixels():
    frames = clutter('noise', 9, shape=(10, 1, 200))
    way = add_target(frames, 12.0, (60, 0), (1.2, 0))
    [found] = searched(frames).found
    assert follows(found, way)


def test_target_beside_which_nothing_is_left_is_no_error():
    frames = clutter('noise', 10, shape=(10, 32, 32))
    frames[:, 6:26, 6:26] += 40
    assert searched(frames).status == 'converged'


def test_frames_of_one_value_hold_nothing():
    assert searched(np.zeros((6, 32, 40), np.float32)).found == []
