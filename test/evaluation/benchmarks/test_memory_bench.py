"""``tbd bench memory`` measures searches that hold all states, and some of them."""

import dataclasses

from track_before_detect.evaluation.benchmarks.memory import BENCH, Case


def test_time_and_memory_are_measured_with_all_states_and_with_few():
    cases = [Case((40, 50), 1.0, memory).measure_here(1) for memory in (1000.0, 0.05)]
    assert [case['n_trajectories'] for case in cases][:1] * 2 == [
        case['n_trajectories'] for case in cases]
    for case in cases:
        assert 0 < case['peak_memory_before_bytes'] <= case['peak_memory_bytes']
        assert case['detection']['cpu_s']['min'] > 0 and case['fill']['wall_s']['min'] > 0
    text = '\n'.join(BENCH.lines({'cases': cases, 'repeats': 1}))
    assert 'all states' in text and '20 x 50 x 40' in text


def test_each_size_is_measured_with_all_states_first():
    [cases] = BENCH.cases(False).values()
    for whole, little in zip(cases[::2], cases[1::2], strict=True):
        assert dataclasses.replace(whole, max_memory_gb=little.max_memory_gb) == little
        assert little.max_memory_gb < 1.5 < whole.max_memory_gb
