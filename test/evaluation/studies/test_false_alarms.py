import numpy as np

from canned import Canned
from track_before_detect.evaluation.studies.false_alarms.runs import noise_alarms
from track_before_detect.evaluation.studies.false_alarms.suite import run_false_alarms


def test_alarms_of_a_higher_threshold_are_among_those_of_a_lower_one():
    counts = np.zeros(3)
    for seed in range(6):
        item = {'side_px': 32, 'thresholds': [20.0, 7.0, 6.0], 'seed': seed}
        alarms = noise_alarms(item)['alarms']
        assert alarms == sorted(alarms)
        counts += alarms
    assert counts[0] == 0 and counts[2] == 6


def test_batches_are_counted_for_each_threshold():
    result = run_false_alarms(1, 3, Canned(answers={'noise_alarms': lambda item: {
        'alarms': [True, item['seed'] % 2 == 0, False][:len(item['thresholds'])]}}))
    by_name = {quantity.name: quantity for quantity in result.quantities}
    assert len(by_name) == len(result.rows) == 7
    assert by_name['64 x 64 px, 50 % requested'].value == 1.0
    assert 0.2 < by_name['64 x 64 px, 5 % requested'].value < 0.8
    rare = by_name['64 x 64 px, 0.5 % requested']
    assert (rare.value, rare.trials, rare.note) == (0.0, 80, 'goal: 0.333 to 0.75 %')
