"""A target that crosses seams of regions is one trajectory with one id."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField

from track_before_detect.errors import DataError
from track_before_detect.ros import conversions
from track_before_detect.ros.stitching.merging import (
    check_sightings,
    KEPT_FRAMES,
    RegionStitcher,
)
from track_before_detect.types import Trajectory

LENGTH, HOP, INTERVAL_S = 10, 5, 0.04
# What the fastest target crosses in a batch, and the point spread function to both sides.
FASTEST, MARGIN = 4.0, 3.0
OVERLAP = FASTEST * LENGTH + 2 * MARGIN
WIDTH, HEIGHT = 300, 240
# Four regions (x, y, right, bottom) that meet in a cross.
REGIONS = [(x, y, x_end, y_end)
           for x, x_end in ((0, 150 + OVERLAP / 2), (150 - OVERLAP / 2, WIDTH))
           for y, y_end in ((0, 120 + OVERLAP / 2), (120 - OVERLAP / 2, HEIGHT))]


# Stamps need not be regular.
STAMPS = 1.7e9 + INTERVAL_S * (
    np.arange(200) + np.random.default_rng(2).uniform(-0.3, 0.3, 200))


def seen(region, first, positions, amplitudes, rng, number=0):
    """Return what a region finds in a batch of a target: in frames outside, noise at its edge."""
    low, high = np.array(region[:2]), np.array(region[2:]) - 1
    inside = ((positions >= low) & (positions <= high)).all(axis=1)
    amplitudes = np.where(inside, amplitudes, rng.standard_normal(LENGTH))
    statistic = np.sqrt(np.sum(amplitudes**2))
    if not inside.any() or statistic < 8.0:
        return []
    frames = first + np.arange(LENGTH)
    return [Trajectory(
        number, np.clip(positions, low, high) + 0.3 * rng.standard_normal((LENGTH, 2)),
        abs(amplitudes), np.tile(np.diff(positions[:2], axis=0) / INTERVAL_S, (LENGTH, 1)),
        STAMPS[frames], np.arange(LENGTH), float(statistic), amplitudes.mean())]


def batches_of(targets, n_batches, snr, rng):
    """Yield positions (T, 2) of each target in a batch, and what each region finds.

    ``targets`` are position and velocity in frame 0.
    """
    # Regions see the same noise where both see the target.
    amplitudes = snr + rng.standard_normal((len(targets), HOP * n_batches + LENGTH))
    for first in HOP * np.arange(n_batches):
        k = first + np.arange(LENGTH)
        positions = [np.add(start, np.outer(k, velocity)) for start, velocity in targets]
        yield positions, [[
            one for number, path in enumerate(positions)
            for one in seen(region, first, path, amplitudes[number, k], rng, number)]
            for region in REGIONS]


@pytest.mark.parametrize('snr', [4.0, 12.0])
@pytest.mark.parametrize('speed', [0.0, 0.4, 1.5, FASTEST])
def test_a_target_that_crosses_seams_at_any_angle_is_found_once_with_one_id(speed, snr):
    rng = np.random.default_rng(3)
    n_batches, n_crossed = 17, 0
    for angle in np.linspace(0.0, 2 * np.pi, 24, endpoint=False) + 0.05:
        velocity = speed * np.array([np.cos(angle), np.sin(angle)])
        # Across the middle, at some distance from where the four regions meet.
        middle = np.array([150, 120]) + rng.uniform(-25, 25, 2)
        start = middle - velocity * 0.5 * HOP * n_batches
        stitcher, ids, regions = RegionStitcher(1.0), set(), set()
        for [path], parts in batches_of([(start, velocity)], n_batches, snr, rng):
            if (path < MARGIN).any() or (path > np.array([WIDTH, HEIGHT]) - 1 - MARGIN).any():
                continue
            merged = stitcher.merge(parts)
            assert len(merged) == 1
            assert np.hypot(*(merged[0].positions - path).T).mean() < 1.0
            ids.add(merged[0].id)
            regions |= {i for i, part in enumerate(parts) if part}
        assert len(ids) == 1
        n_crossed += len(regions) > 1
    assert n_crossed > 12


def test_targets_side_by_side_in_the_overlap_stay_two():
    rng = np.random.default_rng(4)
    stitcher = RegionStitcher(1.0)
    targets = [((110.0, 60.0), (1.0, 0.1)), ((110.0, 66.0), (1.0, 0.1))]
    n_twice = 0
    for paths, parts in batches_of(targets, 12, 9.0, rng):
        merged = {one.id: one for one in stitcher.merge(parts)}
        assert set(merged) == {1, 2}
        means = sorted(one.positions[:, 1].mean() for one in merged.values())
        np.testing.assert_allclose(means, [path[:, 1].mean() for path in paths], atol=0.5)
        n_twice += sum(map(len, parts)) - 2
    assert n_twice > 5


def test_what_one_region_finds_is_never_taken_for_a_double():
    one = seen(REGIONS[0], 0, np.full((LENGTH, 2), 50.0), 9.0, np.random.default_rng(5))[0]
    near = replace(one, id=1, positions=one.positions + 1.0)
    assert len(RegionStitcher(1.0).merge([[one, near], []])) == 2
    assert len(RegionStitcher(1.0).merge([[one], [near]])) == 1


def test_the_stronger_of_two_sightings_stays_whatever_region_it_is_of():
    one = seen(REGIONS[0], 0, np.full((LENGTH, 2), 50.0), 9.0, np.random.default_rng(6))[0]
    weaker = replace(one, positions=one.positions + 1.0, statistic=one.statistic - 1.0)
    for parts in ([[one], [weaker]], [[weaker], [one]]):
        [kept] = RegionStitcher(1.0).merge(parts)
        np.testing.assert_array_equal(kept.positions, one.positions)


def test_another_stream_has_other_ids():
    one = seen(REGIONS[0], 0, np.full((LENGTH, 2), 50.0), 9.0, np.random.default_rng(7))
    stitcher = RegionStitcher(1.0)
    assert [found.id for found in stitcher.merge([one, []])] == [1]
    stitcher.reset()
    assert [found.id for found in stitcher.merge([one, []])] == [2]


@pytest.mark.parametrize('amplitudes', [np.zeros(LENGTH), np.full(LENGTH, np.nan),
                                        np.array([np.nan, *np.full(LENGTH - 1, 9.0)])])
def test_a_target_is_told_once_whatever_is_known_of_its_amplitudes(amplitudes):
    one = seen(REGIONS[0], 0, np.full((LENGTH, 2), 50.0), 9.0, np.random.default_rng(8))[0]
    one = replace(one, amplitudes=amplitudes)
    other = replace(one, positions=one.positions + 0.3)
    assert len(RegionStitcher(1.0).merge([[one], [other]])) == 1


def test_more_frames_than_are_kept_and_stamps_in_no_order_are_no_batch():
    n_frames = KEPT_FRAMES + 1
    one = Trajectory(1, np.zeros((n_frames, 2)), np.ones(n_frames), np.zeros((n_frames, 2)),
                     np.arange(float(n_frames)), np.arange(n_frames), 9.0, 3.0)
    with pytest.raises(DataError, match='at most 2000 frames, got trajectories in 2001'):
        check_sightings([one])
    with pytest.raises(DataError, match='must increase, found those of 1 to go from 2000 to 0 s'):
        check_sightings([replace(one, stamps=one.stamps[::-1])])


NUMBERS = st.sampled_from([0.0, 1.0, -1.0, 3e9, 1e12, 1e300, -1e38, np.nan, np.inf, -np.inf])


@given(st.lists(st.tuples(
    st.sampled_from([name for name in conversions.POINT_DTYPE.names if name != 'id']),
    st.integers(0, LENGTH - 1), NUMBERS), max_size=4),
    st.dictionaries(st.sampled_from(['width', 'height', 'point_step', 'is_bigendian']),
                    st.integers(0, 300), max_size=2),
    st.sampled_from(['', 'twice', 'far', 'short']))
def test_a_cloud_that_may_be_anything_is_merged_or_refused(numbers, told, fault):
    points = np.zeros(LENGTH, conversions.POINT_DTYPE)
    points['t'] = STAMPS[:LENGTH]
    for name, row, number in numbers:
        with np.errstate(over='ignore'):
            points[name][row] = number
    fields = [PointField(name=name, offset=points.dtype.fields[name][1], count=1, datatype={
        'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64, 'i4': PointField.INT32}[
            points.dtype.fields[name][0].str[1:]]) for name in points.dtype.names]
    if fault == 'twice':
        fields.append(fields[0])
    elif fault == 'far':
        fields[0].offset = 2**31
    message = PointCloud2(**{
        'width': LENGTH, 'height': 1, 'point_step': points.itemsize, **told,
        'is_bigendian': bool(told.get('is_bigendian', 0) % 2)}, fields=fields)
    message.data = points.tobytes()[:100 if fault == 'short' else None]
    try:
        found = conversions.trajectories_from_points(message)
        check_sightings(found)
    except DataError:
        return
    merged = RegionStitcher(1.0).merge([found, found])
    conversions.points_from_trajectories(merged, message.header)
    conversions.paths_from_trajectories(merged, message.header)
    conversions.markers_from_trajectories(merged, message.header, 1.0)
