from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.tracking.batcher import Outcome, SlidingWindow

SHAPE = (3, 4)


def frame(value, shape=SHAPE):
    return np.full(shape, value, np.float32)


def feed(window, stamps, first_index=0):
    """Add frames whose pixels are their index; return what was answered."""
    return [window.add(frame(first_index + k), stamp, first_index + k)
            for k, stamp in enumerate(stamps)]


def batches_of(intakes):
    return [intake.batch for intake in intakes if intake.batch is not None]


@settings(deadline=None, max_examples=100)
@given(st.integers(1, 12), st.data())
def test_every_frame_is_in_a_batch_once_the_stream_is_flushed(length, data):
    hop = data.draw(st.integers(1, length))
    n_frames = data.draw(st.integers(0, 40))
    window = SlidingWindow(length, hop)
    batches = batches_of(feed(window, 0.1 * np.arange(n_frames)))
    tail = window.flush()
    if tail is not None:
        batches.append(tail)
    seen = {int(index) for batch in batches for index in batch.frame_indices}
    assert seen == set(range(n_frames))
    assert window.flush() is None


@settings(deadline=None, max_examples=100)
@given(st.integers(1, 12), st.data())
def test_batches_have_the_length_and_start_a_hop_apart(length, data):
    hop = data.draw(st.integers(1, length))
    batches = batches_of(feed(SlidingWindow(length, hop), 0.1 * np.arange(50)))
    assert len(batches) == (50 - length) // hop + 1
    for number, batch in enumerate(batches):
        np.testing.assert_array_equal(batch.frame_indices, number * hop + np.arange(length))
        np.testing.assert_allclose(batch.stamps, 0.1 * batch.frame_indices)
        np.testing.assert_array_equal(batch.frames[:, 0, 0], batch.frame_indices)


def test_no_more_than_a_batch_of_frames_is_held():
    window = SlidingWindow(5, 5)
    feed(window, np.arange(1000.0))
    assert len(window) == 5


def test_a_batch_does_not_change_with_the_frames_that_follow():
    window = SlidingWindow(3, 1)
    batch = batches_of(feed(window, [0.0, 1.0, 2.0]))[0]
    feed(window, [3.0, 4.0], first_index=3)
    np.testing.assert_array_equal(batch.frames[:, 0, 0], [0, 1, 2])


@pytest.mark.parametrize('stamp', [3.0, 2.5], ids=['repeated', 'slightly backward'])
def test_a_repeated_or_slightly_backward_stamp_is_refused_with_a_reason(stamp):
    window = SlidingWindow(4, 2)
    feed(window, [0.0, 1.0, 2.0, 3.0])
    intake = window.add(frame(9), stamp, 9)
    assert intake.outcome is Outcome.REFUSED
    assert intake.batch is None
    assert 'expected a stamp after 3.0' in intake.reason
    # The window is as it was: two more frames complete the next batch.
    batch = batches_of(feed(window, [4.0, 5.0], first_index=4))[0]
    np.testing.assert_array_equal(batch.stamps, [2.0, 3.0, 4.0, 5.0])


def test_a_looped_recording_gives_its_tail_and_starts_again():
    window = SlidingWindow(4, 4)
    first = batches_of(feed(window, [10.0, 11.0, 12.0, 13.0, 14.0]))
    assert window.add(frame(5), 10.0, 5).outcome is Outcome.WAITING
    intake = window.add(frame(6), 11.0, 6)
    assert len(first) == 1
    assert intake.outcome is Outcome.JUMP_BACK
    assert 'jump back' in intake.reason and not intake.left_out
    np.testing.assert_array_equal(intake.batch.stamps, [11.0, 12.0, 13.0, 14.0])
    assert len(window) == 2
    again = batches_of(feed(window, [12.0, 13.0], first_index=7))
    np.testing.assert_array_equal(again[0].frame_indices, [5, 6, 7, 8])


def test_a_recording_shorter_than_the_window_that_loops_starts_again():
    window = SlidingWindow(20, 10)
    feed(window, [0.0, 1.0, 2.0])
    window.add(frame(3), 0.0, 3)
    intake = window.add(frame(4), 1.0, 4)
    assert intake.outcome is Outcome.JUMP_BACK
    # Only a full window is worth searching while frames go on arriving.
    assert intake.batch is None


@pytest.mark.parametrize('first_s', [1.7e9, 100.0], ids=['clock', 'simulated'])
@pytest.mark.parametrize('offset', range(1, 10))
def test_single_stamps_of_zero_are_left_out_and_named(first_s, offset):
    stamps = first_s + 0.1 * np.arange(60)
    stamps[offset::10] = 0.0
    window = SlidingWindow(9, 9)
    answers = feed(window, stamps)
    # What follows the last one tells that it alone is wrong.
    answers.append(window.add(frame(60), first_s + 6.0, 60))
    assert {answer.outcome for answer in answers} == {Outcome.ACCEPTED, Outcome.WAITING}
    assert sum('stamped 0.0' in answer.left_out for answer in answers) == 6
    batches = batches_of(answers)
    assert len(batches) == 6
    good = np.delete(np.arange(60), np.arange(offset, 60, 10))
    np.testing.assert_array_equal(
        np.concatenate([batch.frame_indices for batch in batches]), good)


def test_a_change_of_size_starts_the_window_again():
    window = SlidingWindow(4, 2)
    feed(window, np.arange(5.0))
    intake = window.add(frame(5, (5, 6)), 5.0, 5)
    assert intake.outcome is Outcome.SIZE_CHANGE
    assert '3 x 4' in intake.reason and '5 x 6' in intake.reason
    assert intake.batch.frames.shape == (4, *SHAPE)
    assert window.shape == (5, 6)


def test_a_long_gap_starts_the_window_again_and_a_dropped_frame_does_not():
    window = SlidingWindow(4, 2)
    feed(window, [0.0, 1.0, 2.0])
    assert window.add(frame(3), 4.0, 3).outcome is Outcome.ACCEPTED
    assert window.add(frame(4), 9.0, 4).outcome is Outcome.GAP


def test_a_first_stamp_of_zero_is_forgotten_once_the_third_frame_shows_the_gap():
    window = SlidingWindow(4, 2)
    answers = feed(window, [0.0, *(1.7e9 + 0.25 * np.arange(6))])
    assert [answer.outcome for answer in answers[:4]] == [
        Outcome.ACCEPTED, Outcome.ACCEPTED, Outcome.GAP, Outcome.ACCEPTED]
    assert 'a gap of 1.7e+09 s before the second frame' in answers[2].reason
    assert window.median_interval_s == 0.25
    np.testing.assert_array_equal(
        [batch.frame_indices for batch in batches_of(answers)], [[1, 2, 3, 4], [3, 4, 5, 6]])


@pytest.mark.parametrize('length', [1, 2, 3])
def test_windows_of_few_frames_go_on_after_a_first_gap(length):
    window = SlidingWindow(length, 1)
    batches = batches_of(feed(window, [0.0, *(100.0 + np.arange(6.0))]))
    np.testing.assert_array_equal(batches[-1].frame_indices, np.arange(7 - length, 7))
    assert window.median_interval_s == 1.0


@pytest.mark.parametrize('n_before', [1, 2, 3, 8])
@pytest.mark.parametrize('wild_s', [1e10, 60.0])
def test_a_stream_goes_on_behind_a_frame_from_the_far_future(n_before, wild_s):
    window, good = SlidingWindow(8, 4), 0.25 * np.arange(40)
    answers = feed(window, [*good[:n_before], wild_s, *good[n_before:]])
    last = batches_of(answers)[-1]
    np.testing.assert_allclose(np.diff(last.stamps), 0.25)
    assert last.frame_indices[-1] >= 37
    assert sum(answer.outcome is Outcome.REFUSED for answer in answers) <= 8


def test_frames_that_come_late_for_a_while_start_nothing_again():
    # A second sender behind the first, and a bunch that was held up.
    stamps = [0, 1, 2, 3, 4, 2.5, 5, 3.5, 6, 4.5, 7, 8, 12, 9, 10, 11, 13]
    answers = feed(SlidingWindow(8, 4), stamps)
    assert [answer.outcome for answer in answers].count(Outcome.REFUSED) == 6
    assert {answer.outcome for answer in answers} == {Outcome.ACCEPTED, Outcome.REFUSED}


def test_frames_that_come_in_bunches_at_the_start_are_all_kept():
    answers = feed(SlidingWindow(4, 2), [0.0, 0.5, 0.5001, 0.5002])
    assert {answer.outcome for answer in answers} == {Outcome.ACCEPTED}


def test_the_longest_gap_can_be_given():
    window = SlidingWindow(4, 2, max_gap_s=0.5)
    feed(window, [0.0, 0.1])
    assert window.add(frame(2), 0.7, 2).outcome is Outcome.GAP


def test_a_window_of_one_frame_releases_each_frame():
    batches = batches_of(feed(SlidingWindow(1, 1), [0.0, 1.0, 2.5]))
    assert [batch.stamps.tolist() for batch in batches] == [[0.0], [1.0], [2.5]]


@pytest.mark.parametrize(('length', 'hop', 'gap'), [(0, 1, None), (4, 0, None), (4, 5, None),
                                                    (4, 2, 0.0)])
def test_a_window_that_makes_no_sense_is_refused(length, hop, gap):
    with pytest.raises(ParameterError):
        SlidingWindow(length, hop, gap)


def test_of_several_sensors_stamps_repeat_and_only_what_is_unlike_the_others_is_a_gap():
    window = SlidingWindow(4, 2, several=True)
    # Two at once, then a third, again and again.
    stamps = (np.arange(10)[:, None] + [0.0, 0.0, 0.01]).ravel()
    intakes = [window.add(np.zeros((2, 2)), stamp, k) for k, stamp in enumerate(stamps)]
    assert {intake.outcome for intake in intakes} == {Outcome.ACCEPTED}
    np.testing.assert_array_equal(intakes[3].batch.stamps, [0.0, 0.0, 0.01, 1.0])
    assert window.add(np.zeros((2, 2)), 20.0, 30).outcome is Outcome.GAP
    for k, outcome in enumerate([Outcome.WAITING, Outcome.JUMP_BACK], 31):
        assert window.add(np.zeros((2, 2)), 3.0, k).outcome is outcome
