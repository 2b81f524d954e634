"""Spans of batches that are searched each by itself give what one search of all gives."""

import dataclasses
import json

import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.tracking.recording import detect_recording, SPAN
from track_before_detect.tracking.spans.as_json import as_json, from_json
from track_before_detect.tracking.spans.span_search import changes, search_span

LENGTH, HOP, SHAPE = 8, 4, (24, 32)
# Two whole spans and a part of one.
N_FRAMES = LENGTH + HOP * (2 * SPAN + 2)
OPTIONS = {'threshold': 8.0, 'batch_length': LENGTH, 'hop': HOP}


class Frames:
    def __init__(self, frames, stamps):
        self.frames, self.stamps = frames, stamps

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


class Spans:
    """Searches one span after the other, each on its own, in what travels between processes."""

    def __init__(self, recording, options):
        self.recording, self.options = recording, options

    def changes(self, order, progress):
        # In two parts, with the frame between them in both.
        middle = len(order) // 2
        return (changes(self.recording, order[:middle + 1])
                + changes(self.recording, order[middle:]))

    def found(self, n_spans, repeated, progress):
        # The last one first.
        spans = [json.dumps(as_json(search_span(
            self.recording, SHAPE, self.options, number, repeated)))
            for number in reversed(range(n_spans))]
        return [from_json(json.loads(one)) for one in reversed(spans)]


def scene(seed):
    """Return frames with targets that last, cross one another, enter and leave."""
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((N_FRAMES, *SHAPE)).astype(np.float32)
    for _ in range(5):
        first = int(rng.integers(0, N_FRAMES // 2))
        place, velocity = rng.uniform(4, SHAPE), rng.uniform(-0.25, 0.25, 2)
        for t in range(first, min(first + 50, N_FRAMES)):
            y, x = place + (t - first) * velocity
            add_target(frames[t], x, y, 1.0, 6.0)
    return frames


def both(frames, stamps=None, **more):
    options = DetectorOptions(**{**OPTIONS, **more})
    recording = Frames(frames, np.arange(float(len(frames))) if stamps is None else stamps)
    return (detect_recording(recording, options),
            detect_recording(recording, options, shared=Spans(recording, options)))


def assert_same(whole, shared):
    assert len(shared.trajectories) == len(whole.trajectories)
    for one, other in zip([*whole.trajectories, *whole.rejected],
                          [*shared.trajectories, *shared.rejected], strict=True):
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(other, field.name), getattr(one, field.name))
    np.testing.assert_equal(*([dataclasses.asdict(dataclasses.replace(
        one, trajectories=[], rejected=[])) for one in (shared, whole)]))


@pytest.mark.parametrize('seed', range(4))
def test_spans_give_what_one_search_gives(seed):
    whole, shared = both(scene(seed))
    assert len(whole.trajectories) >= 4
    assert_same(whole, shared)


@pytest.mark.parametrize('more', [
    {'calibration': 'clutter', 'threshold': None, 'background': 'either', 'noise': 'local'},
    {'noise': 'robust', 'presence': 'partial'},
    {'detector': 'greedy', 'amplitude_model': 'either'}])
def test_so_they_do_with_other_options(more):
    whole, shared = both(scene(0), **more)
    assert whole.trajectories
    assert_same(whole, shared)


def test_repeated_frames_gaps_and_pauses_lie_where_they_do_in_one_search(caplog):
    frames, stamps = scene(3), np.arange(float(N_FRAMES))
    frames[30:34] = frames[29]
    # No batch of it holds anything.
    frames[48:60] = np.nan
    frames[5, 3, 4] = 1e30
    stamps[68:] += 100
    stamps[72] = 0
    whole, shared = both(frames, stamps, noise='robust')
    assert len(whole.trajectories) >= 3 and len(whole.remarks) >= 4
    assert whole.n_batches < 2 * SPAN + 3
    assert_same(whole, shared)
