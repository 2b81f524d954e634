"""Spans of batches that are searched each by itself give what one search of all gives."""

import dataclasses
import json

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.tracking.recording import detect_recording, SPAN, Span, spans_of
from track_before_detect.tracking.spans.as_json import as_ends, as_json, from_ends, from_json
from track_before_detect.tracking.spans.span_search import changes, of_all_tiles, search_span

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

    def __init__(self, recording, options, n_parts=1):
        self.recording, self.options, self.n_parts = recording, options, n_parts

    def changes(self, order, progress):
        # In two parts, with the frame between them in both.
        middle = len(order) // 2
        return (changes(self.recording, order[:middle + 1])
                + changes(self.recording, order[middle:]))

    def found(self, spans, progress):
        # The last one first.
        return [self.found_in(span) for span in reversed(spans)][::-1]

    def found_in(self, span):
        if self.n_parts == 1:
            return self.travelled(span)
        found, before = [], None
        for number, batch in enumerate(span.batches):
            one = Span([batch], [*span.earlier, *span.batches[:number]])
            # The last tiles first.
            parts = [self.travelled(one, (part, self.n_parts), before)[0]
                     for part in reversed(range(self.n_parts))]
            found.append(of_all_tiles(parts[::-1]))
            before = before if found[-1] is None else found[-1]
        return found

    def travelled(self, *told):
        return from_json(json.loads(json.dumps(as_json(
            search_span(self.recording, SHAPE, self.options, *told)))))


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


def both(frames, stamps=None, n_parts=1, **more):
    options = DetectorOptions(**{**OPTIONS, **more})
    recording = Frames(frames, np.arange(float(len(frames))) if stamps is None else stamps)
    return (detect_recording(recording, options),
            detect_recording(recording, options, shared=Spans(recording, options, n_parts)))


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


@pytest.mark.parametrize('n_parts', [3, 20])
@pytest.mark.parametrize('more', [{}, {
    'background': 'spatial_median', 'noise': 'robust', 'amplitude_model': 'either'}],
    ids=['as it is', 'much chosen'])
def test_parts_of_the_tiles_give_what_one_search_of_all_tiles_gives(n_parts, more):
    # Tiles of 12 px with a margin of 6 or 7 px: six of them.
    whole, shared = both(scene(1), n_parts=n_parts, tile_px=12, max_speed_px_s=0.1, **more)
    assert len(whole.trajectories) >= 3
    assert_same(whole, shared)


def test_a_threshold_is_that_of_the_first_batch_with_nearly_its_interval():
    # A clock that drifts by more than the batches of one threshold may differ.
    stamps = np.cumsum(np.linspace(1.0, 1.6, N_FRAMES))
    whole, shared = both(scene(0), stamps, threshold=None)
    assert whole.trajectories
    assert_same(whole, shared)
    assert len(spans_of([np.arange(first, first + LENGTH) for first in range(
        0, N_FRAMES - LENGTH, HOP)], stamps)[-1].earlier) > 1


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


def test_a_span_is_told_of_no_frames_but_its_own_and_those_that_made_a_threshold():
    rng = np.random.default_rng(0)
    kept = np.flatnonzero(rng.uniform(size=3000) < 0.5)
    stamps = np.arange(3000) / 25
    # From here on frames are ten times as far apart.
    stamps[2000:] += 9 * (stamps[2000:] - stamps[2000])
    batches = [kept[first:first + LENGTH] for first in range(0, len(kept), HOP)]
    spans = spans_of(batches, stamps)
    assert [len(span.batches) for span in spans[:-1]] == [SPAN] * (len(spans) - 1)
    np.testing.assert_equal([one for span in spans for one in span.batches], batches)
    assert [len(span.earlier) for span in spans] == sorted(len(span.earlier) for span in spans)
    # Of some intervals that differ, and of the shorter batch at the end none.
    assert len(spans[0].earlier) == 0 and 2 <= len(spans[-1].earlier) <= 12


@given(st.sets(st.integers(0, 200), min_size=1))
def test_frames_of_a_batch_travel_as_its_ends_and_what_is_missing(numbers):
    numbers = np.array(sorted(numbers))
    ends = json.loads(json.dumps(as_ends(numbers)))
    np.testing.assert_array_equal(from_ends(ends), numbers)
    assert len(ends) == 2 + np.ptp(numbers) + 1 - len(numbers)
