import numpy as np
import pytest

from track_before_detect.evaluation.benchmarks.numpy_merit import first_order
from track_before_detect.evaluation.studies.ring import readings as ring_readings
from track_before_detect.evaluation.studies.ring.scenes import point_frames


def slow_matched(frames, v_max):
    """Look at all predecessors of every pixel in turn, slowest first."""
    n_frames, height, width = frames.shape
    merit, chosen = frames.copy(), {}
    steps = sorted(((x, y) for x in range(-v_max, v_max + 1) for y in range(-v_max, v_max + 1)),
                   key=lambda v: (v[0]**2 + v[1]**2, v[1], v[0]))
    for t in range(1, n_frames):
        now = {}
        for y in range(height):
            for x in range(width):
                best = None
                for dx, dy in steps:
                    if not (0 <= x - dx < width and 0 <= y - dy < height):
                        continue
                    last = chosen.get((x - dx, y - dy))
                    if last and max(abs(last[0] - dx), abs(last[1] - dy)) > 1:
                        continue
                    value = merit[t - 1, y - dy, x - dx]
                    if best is None or value > best[0]:
                        best = (value, (dx, dy))
                merit[t, y, x] = frames[t, y, x] + (0 if best is None else best[0])
                if best is not None:
                    now[x, y] = best[1]
        chosen = now
    return merit


@pytest.mark.parametrize('v_max', [1, 2])
def test_matching_velocities_equals_a_slow_search(v_max):
    frames = np.random.default_rng(v_max).standard_normal((6, 7, 9)).astype(np.float32)
    np.testing.assert_allclose(ring_readings.matched(frames, v_max), slow_matched(frames, v_max),
                               rtol=1e-5, atol=1e-5)


def test_a_direction_is_followed_by_its_quadrant_alone():
    frames = np.zeros((5, 20, 20), np.float32)
    path = np.array([[4 + t, 12 - t] for t in range(5)])
    frames[range(5), path[:, 1], path[:, 0]] = 1
    merit = ring_readings.by_direction(frames, 1)
    assert merit[4, 8, 8] == 5
    # Turning back takes another quadrant.
    turned = np.zeros((4, 20, 20), np.float32)
    for t, x in enumerate((4, 5, 6, 5)):
        turned[t, 10, x] = 1
    assert ring_readings.by_direction(turned, 1).max() == 3
    assert first_order(turned, 1).max() == 4


def test_path_is_traced_back_to_where_it_came_from():
    truth = np.array([[5 + t, 6 + t // 2] for t in range(12)])
    frames = point_frames(np.random.default_rng(1), truth[None], 30.0, 32)
    np.testing.assert_array_equal(ring_readings.traced(first_order(frames, 1), 1), truth)


def test_section_says_which_readings_agree_with_the_paper():
    results = [{'one': 0.05, 'other': share} for share in (0.1, 0.2, 0.3)]
    text = ring_readings.section(results, {'CSO-DP': 0.3})
    assert '"other" has 20 % in its interval' in text and 'CSO-DP has 30.0 %' in text
    assert '| one | 5.0 % | 5.0 % | 5.0 % |' in text
    text = ring_readings.section([{'one': 0.05, 'other': 0.1}] * 3, {'CSO-DP': 0.3})
    assert 'none has 20 % in its interval; nearest is "other"' in text
