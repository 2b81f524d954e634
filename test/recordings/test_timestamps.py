"""Stamps as files hold them: other units, wrong ones, long pauses."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.timestamps import in_seconds, pieces


@pytest.mark.parametrize(('per_second', 'unit'), [
    (1, 'seconds'), (10**3, 'milliseconds'), (10**6, 'microseconds'), (10**9, 'nanoseconds')])
def test_whole_numbers_since_1970_are_read_in_their_unit(per_second, unit):
    step = max(per_second // 25, 1)
    stamps = 1_700_000_000 * per_second + step * np.arange(50)
    seconds, found = in_seconds(stamps)
    assert found == unit
    assert seconds[0] == pytest.approx(1.7e9)
    np.testing.assert_allclose(np.diff(seconds), step / per_second, rtol=1e-5)


def test_nanoseconds_from_zero_are_told_by_their_distance():
    seconds, found = in_seconds(40_000_000 * np.arange(20))
    assert found == 'nanoseconds'
    np.testing.assert_allclose(seconds, 0.04 * np.arange(20))


@pytest.mark.parametrize('interval', [10_000, 200_000, 1_000_000])
def test_whole_numbers_from_zero_are_rather_slow_microseconds_than_fast_nanoseconds(interval):
    wrong = (interval * np.arange(1, 20)).astype(float)
    wrong[4] = np.nan
    for stamps in (interval * np.arange(1, 20) + 1, wrong + 1):
        seconds, found = in_seconds(stamps)
        assert found == ('microseconds' if interval > 10_000 else 'seconds')


def test_unsigned_and_short_numbers_do_not_go_round():
    for dtype in (np.uint64, np.int8):
        seconds, found = in_seconds(np.array([100, 20, 30], dtype))
        assert found == 'seconds' and seconds.tolist() == [100, 20, 30]
    seconds, found = in_seconds(10**9 * np.array([9, 1, 2, 3], np.uint64))
    assert found == 'nanoseconds' and seconds.tolist() == [9, 1, 2, 3]


@pytest.mark.parametrize('stamps', [
    np.arange(20), 60.0 * np.arange(20), 1.7e9 + 0.04 * np.arange(20), np.array([5.0]),
    3600 * np.arange(5), np.array([0.0, 1.5e-9, 3e-9])])
def test_seconds_stay_seconds(stamps):
    seconds, found = in_seconds(stamps)
    assert found == 'seconds'
    np.testing.assert_array_equal(seconds, stamps)


def test_a_first_stamp_of_zero_is_set_aside():
    stamps = 1.7e9 + 0.04 * np.arange(60)
    stamps[0] = 0
    [piece], remarks = pieces(stamps, 0.8)
    assert piece.tolist() == list(range(1, 60))
    assert len(remarks) == 1 and 'frame 0 is left out' in remarks[0]


@pytest.mark.parametrize('wrong', [0.0, 0.36, np.nan, 1e9])
def test_one_wrong_stamp_costs_one_frame(wrong):
    stamps = 0.04 * np.arange(30)
    stamps[10] = wrong
    [piece], remarks = pieces(stamps, 0.8)
    assert np.setdiff1d(np.arange(30), piece).tolist() == [10]
    assert len(remarks) == 1 and 'frame 10 is left out' in remarks[0]


def test_long_pauses_part_a_recording():
    stamps = np.concatenate([0.04 * np.arange(30), 600 + 0.04 * np.arange(40), [2000.0]])
    found, remarks = pieces(stamps, 0.8)
    assert [len(piece) for piece in found] == [30, 40]
    assert 'frame 70 is left out' in remarks[0]
    assert 'before and after pauses: 599 s before frame 30' in remarks[1]


def test_dropped_frames_are_no_pause():
    keep = np.r_[0:20, 28:60]
    [piece], remarks = pieces(0.04 * keep, 0.8)
    assert len(piece) == len(keep) and not remarks


@given(st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float('nan'))), max_size=40))
def test_what_is_kept_increases_and_nothing_longer_does(values):
    stamps = np.array(values)
    [piece], remarks = pieces(stamps)
    assert np.all(np.diff(stamps[piece]) > 0)
    best = []
    for k, value in enumerate(values):
        if np.isfinite(value):
            before = [best[j] for j in range(k) if np.isfinite(values[j]) and values[j] < value]
            best.append(1 + max(before, default=0))
        else:
            best.append(0)
    assert len(piece) == max(best, default=0)
    assert bool(remarks) == (len(piece) < len(stamps))
