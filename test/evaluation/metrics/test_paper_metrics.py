import itertools

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.paper_metrics import count_points, track_errors
from track_before_detect.evaluation.metrics.roc import roc
from track_before_detect.evaluation.metrics.track_quality import track_quality


def straight(x, y, n_frames=10):
    return np.column_stack([x + np.arange(n_frames), np.full(n_frames, float(y))])


def test_points_of_a_hand_example():
    found = [straight(0, 1.0), straight(0, 30.0), straight(0, 0.5)]
    found[0][6:, 1] = 1.1       # beside the target on one axis, by more than a pixel
    found[1][2:] = np.nan       # two false points
    found[2][:9] = np.nan       # the last point of the target is hit after all
    assert count_points(found, [straight(0, 0), straight(0, 60)]) == (7, 4 + 2)


def test_points_near_on_both_axes_count_and_nothing_is_found_by_nothing():
    diagonal = straight(1.0, 1.0)
    assert count_points([diagonal], [straight(0, 0)]) == (10, 0)
    assert count_points([], [straight(0, 0)]) == (0, 0)
    assert count_points([diagonal], []) == (0, 10)


def test_tracks_are_compared_where_they_end_and_measured_to_cells():
    targets = [straight(0, 0.4), straight(0, 10)]
    late = straight(0, 5.0)
    late[-1, 1] = 2.0
    errors = track_errors([late, straight(0, 13.0)], targets)
    # 1.6 cells off at the end; the mean is over all frames and from the cell at y = 0.
    assert errors.detected.tolist() == [True, False]
    assert errors.squared_errors[0] == pytest.approx((9 * 25 + 4) / 10)
    assert np.isnan(errors.squared_errors[1])


def test_one_track_detects_one_target():
    targets = [straight(0, 0), straight(0, 2)]
    assert track_errors([straight(0, 1)], targets).detected.sum() == 1
    assert track_errors([straight(0, 1), straight(0, 3)], targets).detected.all()
    assert not track_errors([], targets).detected.any()


def slow_quality(found, targets, limit):
    """Pair by trying every way to pair, frame by frame."""
    counts = np.zeros((len(found), len(targets)), int)
    for k in range(len(found[0])):
        best, best_pairs = (0, 0.0), ()
        for chosen in itertools.permutations([*range(len(targets)), *[None] * len(found)],
                                             len(found)):
            pairs = [(i, j) for i, j in enumerate(chosen) if j is not None
                     and np.hypot(*(found[i][k] - targets[j][k])) <= limit]
            total = sum(np.hypot(*(found[i][k] - targets[j][k])) for i, j in pairs)
            if (len(pairs), -total) > best or not best_pairs:
                best, best_pairs = (len(pairs), -total), pairs
        for pair in best_pairs:
            counts[pair] += 1
    frames = [np.isfinite(one).all(axis=1).sum() for one in (*found, *targets)]
    with np.errstate(invalid='ignore'):
        return (counts.max(axis=1) / frames[:len(found)],
                counts.max(axis=0) / frames[len(found):],
                counts.sum(axis=0) / frames[len(found):], (counts > 0).sum(axis=0))


@pytest.mark.parametrize('seed', range(5))
def test_purity_and_completeness_equal_a_slow_count(seed):
    rng = np.random.default_rng(seed)
    found, targets = rng.uniform(0, 6, (3, 8, 2)), rng.uniform(0, 6, (2, 8, 2))
    found[rng.random((3, 8)) < 0.2] = np.nan
    targets[rng.random((2, 8)) < 0.2] = np.nan
    quality = track_quality(found, targets, 2.5)
    expected = slow_quality(found, targets, 2.5)
    for name, values in zip(('purity', 'completeness', 'coverage', 'n_tracks'), expected,
                            strict=True):
        np.testing.assert_allclose(getattr(quality, name), values)


def test_swap_halves_purity_and_completeness_but_not_coverage():
    targets = np.array([straight(0, 0), straight(0, 8)])
    swapped = targets.copy()
    swapped[:, 5:] = targets[::-1, 5:]
    quality = track_quality(swapped, targets, 2.0)
    assert quality.purity.tolist() == quality.completeness.tolist() == [0.5, 0.5]
    assert quality.coverage.tolist() == [1.0, 1.0]
    assert quality.n_tracks.tolist() == [2, 2]


def test_quality_of_nothing():
    quality = track_quality([], [straight(0, 0)], 1.0)
    assert len(quality.purity) == 0 and quality.completeness.tolist() == [0.0]
    assert track_quality([straight(0, 0)], [], 1.0).purity.tolist() == [0.0]
    with pytest.raises(ParameterError, match='limit_px must be above 0, got 0'):
        track_quality([], [], 0.0)


def test_roc_of_a_hand_example():
    curve = roc([9.0, 7.0, np.nan, 5.0], [[6.0], [], [8.0, 7.0], []])
    assert curve.thresholds.tolist() == [9, 8, 7, 6, 5]
    assert (4 * curve.detection_probability[:, 0]).tolist() == [1, 1, 2, 2, 3]
    assert (4 * curve.false_alarms_per_batch[:, 0]).tolist() == [0, 1, 2, 3, 3]
    assert (4 * curve.alarmed_batches[:, 0]).tolist() == [0, 1, 1, 2, 2]
    for values in (curve.detection_probability, curve.false_alarms_per_batch,
                   curve.alarmed_batches):
        assert (values[:, 1] <= values[:, 0]).all() and (values[:, 0] <= values[:, 2]).all()
        assert (np.diff(values, axis=0) >= 0).all()


def test_roc_needs_targets_and_batches():
    with pytest.raises(ParameterError, match='got 0 targets and 1 batches'):
        roc([], [[1.0]])
