"""What the workers that search the parts of one long recording are told."""

from argparse import Namespace
from contextlib import contextmanager
import json

import numpy as np
import pytest

from track_before_detect.cli.spread import spans
from track_before_detect.options import DetectorOptions
from track_before_detect.results.saved import Opened
from track_before_detect.runs.workers import Workers
from track_before_detect.tracking.recording import detect_recording

OPTIONS = DetectorOptions(threshold=9.0, batch_length=4, hop=2, detector='greedy')


@pytest.fixture
def told(monkeypatch):
    """Let this process be the worker; return what it is told, an item for each part."""
    items = []

    class Kept:
        def __init__(self, path):
            pass

        def load(self, measure):
            return {}

        @contextmanager
        def writer(self, measure):
            yield lambda item, result: items.append(json.loads(item))

    monkeypatch.setattr(spans, 'workers_of', lambda arguments: Workers(jobs=1))
    monkeypatch.setattr(spans, 'KeptResults', Kept)
    return items


def test_each_part_is_told_of_its_own_repeats_and_files_are_looked_at_once_for_all(
        told, tmp_path, monkeypatch):
    frames = np.random.default_rng(0).standard_normal((240, 8, 9)).astype(np.float32)
    # Every fourth one repeats that before.
    frames[3::4] = frames[2::4]
    np.save(tmp_path / 'a.npy', frames)
    states, looked_at = spans.states_of, []
    monkeypatch.setattr(spans, 'states_of', lambda path, options: (
        looked_at.append(path), states(path, options))[1])
    source = Opened(tmp_path / 'a.npy')
    with (source.open() as recording,
          spans.on_workers(source, Namespace(output=tmp_path)) as share):
        shared = detect_recording(recording, OPTIONS, shared=share(OPTIONS, recording.shape))
        alone = detect_recording(recording, OPTIONS)
    assert shared.remarks == alone.remarks and '60 of 240' in shared.remarks[-1]
    assert shared.best_statistic == alone.best_statistic
    # For the repeats, and for the search.
    assert len(looked_at) == 2
    parts = [item for item in told if 'batches' in item]
    assert len(parts) == -(-shared.n_batches // 8) > 8
    # 8 batches with a hop of 2 reach over 18 frames that are new, and 6 that are not.
    for part in parts:
        assert np.ptp(np.concatenate(part['batches'])) < 26
        assert len(np.concatenate([*part['batches'], *part['earlier']])) < 50


@pytest.mark.parametrize(('n_workers', 'n_spans', 'n_parts'), [(3, 1, 3), (3, 2, 2), (2, 2, 1),
                                                               (50, 1, 6)])
def test_tiles_of_few_parts_give_each_worker_something_to_do(
        told, tmp_path, monkeypatch, n_workers, n_spans, n_parts):
    monkeypatch.setattr(Workers, 'count', lambda self: n_workers)
    options = OPTIONS.replace(tile_px=16, max_speed_px_s=0.2)
    frames = np.random.default_rng(0).standard_normal((16 * n_spans + 2, 30, 40))
    frames[:, 14:17, 15:18] += 6
    np.save(tmp_path / 'a.npy', frames.astype(np.float32))
    source = Opened(tmp_path / 'a.npy')
    with (source.open() as recording,
          spans.on_workers(source, Namespace(output=tmp_path)) as share):
        shared = detect_recording(recording, options, shared=share(options, recording.shape))
        alone = detect_recording(recording, options)
    parts = [item['part'] for item in told if 'part' in item]
    n_batches = alone.n_batches
    assert parts == ([[part, n_parts] for _ in range(n_batches) for part in range(n_parts)]
                     if n_parts > 1 else [])
    assert len(alone.trajectories) == len(shared.trajectories) == 1
    np.testing.assert_array_equal(shared.trajectories[0].positions,
                                  alone.trajectories[0].positions)
