"""Frames that hold nothing new are told from frames in which little moves."""

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.tracking.repeated_frames import RepeatedFrames


def told(frames):
    repeated = RepeatedFrames()
    return [repeated.repeats(frame) for frame in frames], repeated.count


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16, np.float32])
def test_a_frozen_camera_repeats(dtype):
    frames = (100 + 5 * np.random.default_rng(1).standard_normal((30, 16, 16))).astype(dtype)
    frames[12:20] = frames[11]
    expected = [12 <= k < 20 for k in range(30)]
    assert told(frames) == (expected, 8)


def test_a_few_changed_blocks_are_still_a_repeat():
    frames = np.random.default_rng(2).integers(0, 9, (20, 32, 32)).astype(np.uint8)
    frames[10] = frames[9]
    frames[10, :4, :4] += 1
    assert told(frames)[0] == [k == 10 for k in range(20)]


def test_frames_are_compared_with_the_one_before_though_it_was_a_repeat():
    frames = np.random.default_rng(2).integers(0, 9, (32, 40, 40)).astype(np.uint8)
    frames[20:] = frames[19]
    for k, frame in enumerate(frames[20:], 1):
        # One row of forty differs from the frame before, k from the last one that was new.
        frame[:k] += 1
    assert told(frames)[0] == [k >= 20 for k in range(32)]


def test_a_picture_without_noise_repeats_nothing():
    still = np.zeros((10, 16, 16))
    still[:, 8, 8] = 20.0
    moving = np.zeros((10, 16, 16))
    moving[np.arange(10), 8, np.arange(10)] = 20.0
    slow = np.zeros((10, 16, 16))
    slow[np.arange(10), 8, np.arange(10) // 3] = 20.0
    assert told(still)[1] == told(moving)[1] == told(slow)[1] == 0


def test_a_frame_without_data_repeats_nothing():
    frames = np.random.default_rng(3).standard_normal((8, 9, 9))
    frames[3:5] = np.nan
    assert told(frames)[1] == 0


def test_a_target_is_followed_through_a_pause_under_one_id():
    rng = np.random.default_rng(4)
    frames = rng.standard_normal((50, 32, 32))
    y, x = np.mgrid[:32, :32]
    for t, frame in enumerate(frames):
        frame += 15 * np.exp(-0.5 * ((x - 5 - 0.3 * t)**2 + (y - 16)**2))
    frames[20:28] = frames[19]
    result = tbd.detect(frames, threshold=12, batch_length=20)
    [found] = result.trajectories
    seen = np.isfinite(found.positions[:, 0])
    assert seen.sum() == 42 and not seen[20:28].any()
    np.testing.assert_allclose(found.positions[seen, 0], (5 + 0.3 * np.arange(50))[seen], atol=1)
    assert '8 of 50 frames repeat the one before' in result.remarks[0]
