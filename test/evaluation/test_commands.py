"""The commands ``tbd evaluate`` and ``tbd bench``, with stand-ins for the work."""

import dataclasses
import json
import logging
import os

import pytest

from track_before_detect import cli
from track_before_detect.evaluation.benchmarks import convex as bench
from track_before_detect.evaluation.benchmarks import registry as benches
from track_before_detect.evaluation.benchmarks.path_search import SearchCase
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.engine.suite import Suite, SuiteResult
from track_before_detect.evaluation.studies import registry as suites


@pytest.fixture(autouse=True)
def quiet_logging(monkeypatch):
    """Keep the command from configuring the logging of the tests."""
    monkeypatch.setattr(logging, 'basicConfig', lambda **_: None)


@pytest.fixture
def stand_in(monkeypatch):
    """Add a suite that reports what it was given."""
    def study(runs, seed, runner):
        runner.progress('studying', 0.0)
        if runs == 13:
            raise KeyboardInterrupt
        return SuiteResult('Title', 'What was done.', [{'runs': runs, 'seed': seed}],
                           [Quantity('share', 0.5, 0.25, 0.75, runs, 'runs', '%', 'goal: 1 %')],
                           {}, lambda figure: figure.subplots())

    monkeypatch.setitem(suites.SUITES, 'study', Suite('A study.', study))


def run(*arguments):
    """Return the exit code of the command."""
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return stop.code


def assert_one_sentence(capsys, *fragments):
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith('tbd: error: ')
    assert len(lines) == 1
    for fragment in fragments:
        assert fragment in lines[-1]


def test_evaluate_prints_the_table_and_writes_all_files(stand_in, tmp_path, capsys):
    pytest.importorskip('matplotlib')
    output = tmp_path / 'of my study'
    assert run('evaluate', 'study', '--runs', 4, '--seed', 9, '--output', output) == 0
    assert sorted(os.listdir(output)) == [
        'report.md', 'study.csv', 'study.png', 'summary.json']
    assert (output / 'study.csv').read_text() == 'runs,seed\n4,9\n'
    captured = capsys.readouterr()
    assert 'share     50.0 %  25.0 % to 75.0 %  4 runs  goal: 1 %' in captured.out
    assert captured.err == 'tbd: studying\n'
    summary = json.loads((output / 'summary.json').read_text())
    assert summary['settings'] == {'runs': 4, 'seed': 9}
    command = summary['command']
    assert command == f"tbd evaluate study --runs 4 --seed 9 --output '{output}'"
    assert command in (output / 'report.md').read_text()


def test_interrupted_study_leaves_no_output(stand_in, tmp_path):
    pytest.importorskip('matplotlib')
    assert run('evaluate', 'study', '--runs', 13, '--output', tmp_path / 'out') == 130
    assert not (tmp_path / 'out').exists()


def test_list_names_every_suite(stand_in, capsys):
    assert run('evaluate', '--list') == 0
    out = capsys.readouterr().out
    assert all(f'  {name}\n' in out for name in ('detection', 'study'))


@pytest.mark.parametrize(
    ('arguments', 'fragments'),
    [(['evaluate'], ['SUITE']),
     (['evaluate', 'detecton'], ['unknown suite', 'did you mean detection']),
     (['evaluate', 'detection', '--runs', '0'], ['runs must be at least 1, got 0']),
     (['evaluate', 'detection', '--runs', 'many'], ['--runs', "'many'"]),
     (['evaluate', 'detection', '--seed', '-3'], ['seed must not be negative, got -3']),
     (['evaluate', 'detection', '--output', 'file'], ['must be a folder', 'file']),
     (['bench', 'convx'], ['unknown bench', 'did you mean convex']),
     (['bench', '--repeats', '0'], ['repeats must be at least 1, got 0']),
     (['bench', '--output', 'a.csv'], ['must end with .json', 'a.csv']),
     (['bench', '--output', 'no/such/a.json'], ['no/such', 'does not exist'])])
def test_bad_argument_is_one_sentence_exit_code_2_and_no_output(
        tmp_path, monkeypatch, capsys, arguments, fragments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'file').touch()
    assert run(*arguments) == 2
    assert_one_sentence(capsys, *fragments)
    assert os.listdir(tmp_path) == ['file']


def test_bench_measures_and_writes_what_it_prints(tmp_path, monkeypatch, capsys):
    # Of the size that other tests calibrate.
    tiny = bench.Case('tiny', 'noise', {'height': 40, 'width': 44, 'n_frames': 6})
    searches = [SearchCase('one', 8, (20, 50))]
    monkeypatch.setitem(benches.BENCHES, 'convex', dataclasses.replace(
        bench.BENCH, cases=lambda large: {'cases': [tiny], 'searches': searches if large else []}))
    output = tmp_path / 'b.json'
    assert run('bench', 'convex', '--repeats', 1, '--large', '--output', output) == 0
    measured = json.loads(output.read_text())
    assert measured['bench'] == 'convex' and len(measured['cases']) == 1
    assert [case['n_positions'] for case in measured['searches']] == [1000]
    out = capsys.readouterr().out
    assert bench.BENCH.table(measured) in out and str(output) in out


def test_help_says_what_is_written(capsys):
    assert run('evaluate', '--help') == 0
    assert run('bench', '--help') == 0
    out = capsys.readouterr().out
    assert 'report.md' in out and '--large' in out


def test_a_suite_of_real_recordings_needs_a_folder(stand_in, tmp_path, capsys):
    pytest.importorskip('matplotlib')
    output = tmp_path / 'out'
    assert run('evaluate', 'real', '--output', output) == 2
    assert_one_sentence(capsys, '--data', 'this one needs it')
    assert run('evaluate', 'study', '--data', tmp_path, '--output', output) == 2
    assert_one_sentence(capsys, '--data', 'this one simulates its own')
    assert run('evaluate', 'real', '--data', tmp_path / 'absent', '--output', output) == 2
    assert_one_sentence(capsys, 'absent is no folder')
    assert run('evaluate', 'study', '--methods', 'auto', '--output', output) == 2
    assert_one_sentence(capsys, '--methods is for studies that can do with some', 'got auto')
    assert run('evaluate', 'compare', '--methods', 'convex,untold', '--output', output) == 2
    assert_one_sentence(capsys, "unknown method 'untold'", 'convex-untold')
    chosen = '--data', tmp_path, '--methods', 'pc_d'
    assert run('evaluate', 'real', *chosen, '--output', output) == 2
    assert_one_sentence(capsys, "unknown method 'pc_d'", 'pc_dp')


def test_a_suite_is_repeated_as_often_as_it_says_unless_told(monkeypatch, tmp_path):
    pytest.importorskip('matplotlib')
    told = []

    def study(runs, seed, runner, data):
        told.append((runs, data))
        return SuiteResult('Title', 'What was done.', [{'runs': runs}],
                           [Quantity('share', 0.5, 0.25, 0.75, runs, 'runs')], {},
                           lambda figure: figure.subplots())

    monkeypatch.setitem(suites.SUITES, 'study', Suite('A study.', study, True, runs=3))
    for arguments in ([], ['--runs', 7]):
        assert run('evaluate', 'study', '--data', 'my data', *arguments, '--output',
                   tmp_path / 'out') == 0
    assert told == [(3, 'my data'), (7, 'my data')]
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['command'].startswith("tbd evaluate study '--data=my data' --runs 7")
