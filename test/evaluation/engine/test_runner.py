import json
from pathlib import Path
import sys
import threading

import pytest

from canned import quiet
from track_before_detect.errors import MissingExtraError, ParameterError
from track_before_detect.evaluation import studies
from track_before_detect.evaluation.engine.runner import Runner
from track_before_detect.evaluation.engine.seeds import items_of, seeds_of
from track_before_detect.parallel import usable_cores
from track_before_detect.runs.kept_results import KeptResults, sources_of
from track_before_detect.runs.workers import Workers

ITEMS = [{'seed': seed, 'scale': 0.5} for seed in (3, 1, 4, 1, 5)]
HALVES = [{'value': 0.5 * item['seed']} for item in ITEMS]

calls: list[int] = []


@pytest.fixture(autouse=True)
def no_calls():
    calls.clear()


def scaled(item):
    calls.append(item['seed'])
    return {'value': item['scale'] * item['seed']}


def failing_at_four(item):
    if item['seed'] == 4:
        raise KeyboardInterrupt
    return scaled(item)


def test_results_come_in_the_order_of_the_items_and_equal_items_are_run_once():
    assert Runner(quiet).map(scaled, ITEMS, 'scaling') == HALVES
    assert calls == [3, 1, 4, 5]


def test_workers_decide_nothing(tmp_path):
    pytest.importorskip('joblib')
    for jobs in (1, 3):
        runner = Runner(quiet, Workers(jobs, 'threading'))
        assert runner.map(scaled, ITEMS, 'scaling') == HALVES


def cores_of(item):
    return {'cores': usable_cores()}


def test_runs_side_by_side_share_the_cores():
    pytest.importorskip('joblib')
    [alone] = Runner(quiet).map(cores_of, ITEMS[:1], 'counting')
    assert alone['cores'] == usable_cores()
    for jobs in (2, 1000):
        for one in Runner(quiet, Workers(jobs, 'threading')).map(cores_of, ITEMS, 'counting'):
            assert one['cores'] == max(1, usable_cores() // jobs)


def test_interrupted_study_goes_on_where_it_stopped(tmp_path):
    runner = Runner(quiet, kept=KeptResults(tmp_path / 'runs.jsonl'))
    with pytest.raises(KeyboardInterrupt):
        runner.map(failing_at_four, ITEMS, 'scaling')
    assert calls == [3, 1]
    calls.clear()
    more = [*ITEMS, {'seed': 9, 'scale': 0.5}]
    kept = (tmp_path / 'runs.jsonl').read_text()
    (tmp_path / 'runs.jsonl').write_text(kept.replace('failing_at_four', 'scaled'))
    assert runner.map(scaled, more, 'scaling') == [*HALVES, {'value': 4.5}]
    assert calls == [4, 5, 9]


def test_result_cut_short_is_run_again(tmp_path):
    path = tmp_path / 'runs.jsonl'
    runner = Runner(quiet, kept=KeptResults(path))
    runner.map(scaled, ITEMS, 'scaling')
    path.write_bytes(path.read_bytes()[:-12])
    calls.clear()
    assert runner.map(scaled, ITEMS, 'scaling') == HALVES
    assert calls == [5]
    # What was appended after the torn line is read again.
    assert runner.map(scaled, ITEMS, 'scaling') == HALVES
    assert calls == [5]


def test_results_of_other_code_do_not_count(tmp_path):
    path = tmp_path / 'runs.jsonl'
    runner = Runner(quiet, kept=KeptResults(path))
    runner.map(scaled, ITEMS, 'scaling')
    # A line names the function and a digest of its code.
    lines = [json.loads(line) for line in path.read_text().split('\n') if line]
    for line in lines:
        name, digest = line[0].split()
        line[0] = f'{name} {digest[::-1]}'
    path.write_text(''.join(f'{json.dumps(line)}\n' for line in lines))
    calls.clear()
    assert runner.map(scaled, ITEMS, 'scaling') == HALVES
    assert calls == [3, 1, 4, 5]


def test_sources_are_those_that_a_module_comes_to_import():
    sources = sources_of('track_before_detect.evaluation.studies.ring.runs')
    names = {name.removeprefix('track_before_detect.') for name in sources}
    assert {'evaluation.studies.ring.runs', 'evaluation.metrics.paper_metrics',
            'solvers.ring.linking', 'kernels.ring.second_order', 'errors'} <= names
    assert not any(name.startswith(('ros', 'cli', 'solvers.convex')) for name in names)


@pytest.mark.parametrize('study', sorted(
    path.parent.name for path in Path(studies.__file__).parent.glob('*/runs.py')))
def test_results_stay_when_a_table_or_a_picture_changes(study):
    names = {name.rpartition('.')[2] for name in
             sources_of(f'track_before_detect.evaluation.studies.{study}.runs')}
    assert 'runs' in names
    assert not names & {'suite', 'report', 'tables', 'pictures', 'quantities'}


def test_progress_counts_what_is_known_already(tmp_path):
    seen = []
    runner = Runner(lambda label, done: seen.append(done), kept=KeptResults(tmp_path / 'r'))
    runner.map(scaled, ITEMS[:2], 'scaling')
    seen.clear()
    runner.map(scaled, ITEMS, 'scaling')
    assert seen[0] >= 0.4 and seen[-1] == 1.0 and seen == sorted(seen)


def test_without_joblib_runs_follow_one_another_in_this_process(monkeypatch):
    monkeypatch.setitem(sys.modules, 'joblib', None)

    def thread_of(item):
        return {'thread': threading.get_ident()}

    done = Runner(quiet, Workers()).map(thread_of, ITEMS, 'running')
    assert {result['thread'] for result in done} == {threading.get_ident()}
    with pytest.raises(MissingExtraError, match=r'track_before_detect\[parallel\]'):
        Runner(quiet, Workers(2)).map(scaled, ITEMS, 'scaling')


@pytest.mark.parametrize(
    ('options', 'message'),
    [({'jobs': 0}, 'jobs must be at least 1, got 0'),
     ({'backend': 'carrier'}, "backend must be one of loky, .*, got 'carrier'"),
     ({'scheduler': 'tcp://here:1'}, "scheduler needs the backend dask or ray, got 'loky'")])
def test_workers_that_cannot_be_had_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        Workers(**options)


def test_cluster_that_is_not_installed_is_named(monkeypatch):
    pytest.importorskip('joblib')
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(MissingExtraError, match=r'track_before_detect\[dask\]'):
        Runner(quiet, Workers(2, 'dask')).map(scaled, ITEMS, 'scaling')


def test_seeds_depend_on_study_and_part_and_a_longer_study_begins_alike():
    assert seeds_of(1, 'a', 5)[:3] == seeds_of(1, 'a', 3)
    assert not set(seeds_of(1, 'a', 5)) & set(seeds_of(1, 'b', 5))
    assert not set(seeds_of(1, 'a', 5)) & set(seeds_of(2, 'a', 5))
    assert all(0 <= seed < 2**53 for seed in seeds_of(1, 'a', 5))


def test_items_of_a_part_differ_in_their_seed_alone():
    assert items_of(1, 'a', 2, snr=3.0) == [{'snr': 3.0, 'seed': seed}
                                            for seed in seeds_of(1, 'a', 2)]
