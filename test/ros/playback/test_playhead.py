"""Where playing is, by a clock that the test sets."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')

from track_before_detect.ros.playback.playhead import Playhead  # noqa: E402

POSITIONS = np.array([0.0, 1.0, 2.0, 4.0])


@pytest.fixture
def head():
    head = Playhead(POSITIONS, interval_s=1.5)
    head.seek(0, 100.0)
    return head


def test_frames_are_due_at_their_positions(head):
    due = []
    while not head.is_over:
        due.append(head.due_s())
        head.pass_frame(due[-1])
    np.testing.assert_allclose(due, 100.0 + POSITIONS)


def test_a_pause_puts_off_what_follows_by_its_length(head):
    head.pass_frame(100.0)
    head.pause(100.25)
    assert head.due_s() == math.inf
    assert head.position_s(107.0) == 0.25
    head.resume(107.0)
    assert head.due_s() == pytest.approx(107.75)


def test_a_rate_counts_from_where_it_is_set(head):
    head.pass_frame(100.0)
    head.set_rate(2.0, 100.5)
    assert head.position_s(100.6) == pytest.approx(0.7)
    assert head.due_s() == pytest.approx(100.75)


def test_so_many_frames_are_played_then_it_stands_at_the_last(head):
    head.pause(100.0)
    head.play_next(2, 105.0)
    assert head.due_s() == 105.0
    head.pass_frame(105.0)
    assert head.due_s() == 106.0
    head.pass_frame(106.0)
    assert head.paused
    assert (head.next, head.position_s(200.0)) == (2, 1.0)


def test_it_starts_again_one_interval_after_the_last_frame(head):
    head.seek(3, 110.0)
    head.pass_frame(110.0)
    assert head.is_over
    head.start_again(110.1)
    assert (head.next, head.due_s()) == (0, 111.5)


def test_only_frames_within_the_limits_are_played(head):
    assert head.frames_between(0.5, 2.0) == (1, 3)
    head.limit(1, 3, 100.0)
    assert (head.next, head.due_s()) == (1, 100.0)
    head.seek(3, 101.0)
    assert head.is_over


def test_the_position_is_not_beyond_a_frame_that_is_late(head):
    assert head.position_s(150.0) == 0.0
    head.pause(150.0)
    head.resume(160.0)
    assert head.due_s() == 160.0
