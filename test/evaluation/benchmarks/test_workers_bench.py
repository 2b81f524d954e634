"""``tbd bench workers`` writes recordings that are read as they were made, and searches them."""

import numpy as np
import pytest

from track_before_detect.evaluation.benchmarks.workers import bench
from track_before_detect.evaluation.benchmarks.workers.recordings import (
    simulated,
    write_recordings,
)
from track_before_detect.recordings.open_recording import open_recording


def test_recordings_of_all_formats_hold_what_was_simulated(tmp_path):
    for package in ('PIL', 'tifffile', 'astropy', 'av'):
        pytest.importorskip(package)
    paths = write_recordings(tmp_path, 8, 5, 32)
    assert len(paths) == 8 and len({path.suffix for path in paths}) >= 7
    for seed, path in enumerate(paths):
        with open_recording(path) as recording:
            read = np.stack([recording[k] for k in range(len(recording))])
        np.testing.assert_array_equal(read, simulated(seed, 5, 32))


def test_a_run_is_timed_and_leaves_results_with_trajectories(tmp_path):
    paths = write_recordings(tmp_path, 2, 40, 32)
    wall_s, cpu_s, peak = bench.search(paths, tmp_path / 'out', bench.ALONE)
    found = bench.results_in(tmp_path / 'out')
    assert wall_s > 0 and cpu_s > 0
    # Of a process that has loaded the compiler, in bytes.
    assert 5e7 < peak < 5e9
    assert len(found) == 4
    # Of each a head, and more.
    assert all(text.count(b'\n') > 1 for name, text in found.items() if name.endswith('.csv'))


def test_the_table_says_how_many_results_are_the_same():
    run = {'wall_s': {'min': 2.0}, 'cpu_s': {'min': 3.0}, 'n_same': 79, 'speed_up': 1.75,
           'peak_memory_bytes': 2**30}
    text = '\n'.join(bench.BENCH.lines({'repeats': 1, 'cases': [{
        'n_recordings': 40, 'n_frames': 60, 'side_px': 64, 'tile_px': 32, 'n_results': 80,
        'formats': ['', '.npz'], 'runs': {'2 workers': run}}]}))
    assert '79 of 80' in text and '1.75' in text and '.npz, images' in text
