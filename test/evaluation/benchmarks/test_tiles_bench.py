"""``tbd bench tiles`` plants targets on every seam, and counts those that are found once."""

import numpy as np

from track_before_detect.evaluation.benchmarks.tiles import BENCH, Case, planted


def test_targets_lie_across_every_seam_and_corner_of_the_tiles():
    middle = planted(Case(96, 32)).mean(axis=1)
    assert len(middle) == 2 * 2 * 3 + 2 * 2
    for seam in (31.5, 63.5):
        for axis in (0, 1):
            assert np.isclose(middle[:, axis], seam).sum() == 3 + 2


def test_each_is_found_once_and_what_that_took_is_told():
    case = Case(64, 32).measure_here(1)
    assert case['n_targets'] == case['n_found_once'] == 5
    assert case['detection']['cpu_s']['min'] > 0 and case['peak_memory_bytes'] > 1e7
    text = '\n'.join(BENCH.lines({'cases': [case], 'repeats': 1}))
    assert '20 x 64 x 64' in text
