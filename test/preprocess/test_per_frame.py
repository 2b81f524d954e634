"""Work on single frames is kept as long as they are the same."""

import numpy as np
import pytest

from track_before_detect.preprocess.per_frame import each_frame, KeptFrames, shown


@pytest.mark.parametrize('side', [4, 300])
def test_each_frame_is_worked_on_with_what_belongs_to_it(side):
    frames = np.arange(6.0)[:, None, None] * np.ones((side, side))
    found = each_frame(lambda frame, other: (frame[0, 0], other), frames, 'abcdef')
    assert found == list(zip(range(6), 'abcdef', strict=True))


def test_a_frame_is_shown_by_one_pixel():
    frames = np.full((3, 4, 5), np.nan)
    frames[1, 3, 2] = 0
    assert shown(frames).tolist() == [False, True, False]


def numbered(numbers):
    frames = np.random.default_rng(1).normal(size=(40, 6, 7)).astype(np.float32)
    frames[:, 2, 3] = np.nan
    return frames[numbers], np.array(numbers)


class Worker:
    def __init__(self):
        self.seen = []

    def __call__(self, frame, factor):
        self.seen.append(frame[0, 0])
        return factor * frame


def test_only_frames_that_are_new_or_changed_are_worked_on():
    worker, kept = Worker(), KeptFrames(8)
    frames, numbers = numbered(range(16))
    first = kept.each(worker, frames, numbers, 2.0)
    np.testing.assert_array_equal(first, 2 * frames)
    # What happens to the frames of a batch is no matter to the next one.
    frames[:] = 0
    frames, numbers = numbered(range(8, 24))
    frames[3, 1, 1] += 1
    worker.seen.clear()
    second = kept.each(worker, frames, numbers, 2.0)
    np.testing.assert_array_equal(second, 2 * frames)
    assert sorted(worker.seen) == sorted(frames[[3, *range(8, 16)], 0, 0])
    # Other parameters are other work.
    np.testing.assert_array_equal(kept.each(worker, frames, numbers, 3.0), 3 * frames)


@pytest.mark.parametrize('n_kept', [0, 3])
def test_no_more_frames_are_kept_than_asked_for(n_kept):
    worker, kept = Worker(), KeptFrames(n_kept)
    frames, numbers = numbered(range(10))
    kept.each(worker, frames, numbers, 1.0)
    kept.each(worker, frames, numbers, 1.0)
    assert len(worker.seen) == 20 - n_kept


def test_frames_of_another_size_are_other_frames():
    worker, kept = Worker(), KeptFrames(4)
    frames, numbers = numbered(range(4))
    kept.each(worker, frames, numbers, 1.0)
    smaller = kept.each(worker, frames[:, :5], numbers, 1.0)
    np.testing.assert_array_equal(smaller, frames[:, :5])
