"""``tbd evaluate``: repeat a study over many recordings."""

from argparse import Namespace
from pathlib import Path
import shlex
from typing import Any

from track_before_detect.cli.console import (
    add_output_argument,
    check_output_folder,
    FOUND,
    indented,
    PrintAndExit,
    Progress,
)

HELP = 'repeat a study over many recordings'
DESCRIPTION = (
    'Repeat a study over many recordings, simulated ones but for the suites real '
    'and real-alarms, print its table and write to DIR:\n'
    '  report.md     the table with 95 % intervals, and the command that made it\n'
    '  SUITE.csv     one row per run\n'
    '  SUITE.png     the picture of the report\n'
    '  summary.json  the table with settings and machine\n'
    '  runs.jsonl    single results: the same command continues from them after an\n'
    '                interruption, and one with more runs adds to them; may be deleted')
EXAMPLES = """\
examples:
  tbd evaluate --list
  tbd evaluate detection --runs 200 --seed 1 --output evaluation
  tbd evaluate ring-single --runs 20 --output ring --jobs 4
  tbd evaluate compare --runs 20 --methods convex,convex-untold,greedy
  tbd evaluate real --data recordings --output real
  tbd evaluate real --data recordings --methods auto,mff_dpr,trackpy
  on a cluster (joblib's Dask or Ray backend):
    tbd evaluate ring-single --runs 1000 --output ring --backend dask --scheduler tcp://host:8786
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    parser.add_argument('suite', metavar='SUITE', help='name of the study; see --list')
    parser.add_argument('--runs', metavar='N', type=int,
                        help='how often it is repeated (default: 100; of real 1, of '
                        'real-alarms 2)')
    parser.add_argument('--data', metavar='FOLDER',
                        help='recordings with truth, for the suites real and real-alarms')
    parser.add_argument('--methods', metavar='NAMES', default='',
                        help='some of those that the suite compare or real compares, separated by '
                        'commas (default: all)')
    parser.add_argument('--seed', metavar='S', type=int, default=0,
                        help='the same seed gives the same recordings (default: 0)')
    add_output_argument(parser, folder='evaluation')
    parser.add_argument('--jobs', metavar='N', type=int,
                        help='runs at a time (default: one per core with joblib, else one)')
    parser.add_argument('--backend', metavar='NAME', default='loky',
                        help='backend of joblib that carries out the runs: loky (default), '
                        'threading, multiprocessing, dask, ray')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='address of a Dask scheduler or a Ray cluster; without it dask and '
                        'ray start workers on this machine')
    parser.add_argument('--list', action=PrintAndExit, text=_listed, help='list the suites')


def run(arguments: Namespace) -> int:
    """Run a suite, print its table and write its files; return the exit code."""
    from track_before_detect.evaluation.engine.report import (
        require_matplotlib,
        table_text,
        write_suite_result,
    )
    from track_before_detect.evaluation.engine.runner import Runner
    from track_before_detect.evaluation.studies.registry import suite_named
    from track_before_detect.runs.kept_results import KeptResults
    from track_before_detect.runs.workers import Workers

    suite = suite_named(arguments.suite)
    output = Path(arguments.output)
    workers = Workers(arguments.jobs, arguments.backend, arguments.scheduler)
    check_output_folder(output)
    require_matplotlib()
    runs = suite.runs if arguments.runs is None else arguments.runs
    told = [f'--{name}={value}' for name in ('data', 'methods')
            if (value := getattr(arguments, name))]
    command = shlex.join(['tbd', 'evaluate', arguments.suite, *told, '--runs', str(runs),
                          '--seed', str(arguments.seed), '--output', arguments.output])
    with Progress.asked_for(arguments) as progress:
        result = suite.run(runs, arguments.seed, Runner(
            progress, workers, KeptResults(output / 'runs.jsonl')), arguments.data,
            [name.strip() for name in arguments.methods.split(',') if name.strip()])
    written = write_suite_result(output, arguments.suite, result, command)
    print(table_text(result.quantities))
    print(f'written: {", ".join(map(str, written))}')
    return FOUND


def _listed() -> str:
    """Return all suites."""
    from track_before_detect.evaluation.studies.registry import SUITES
    return '\n'.join(f'  {name}\n{indented(suite.description)}' for name, suite in SUITES.items())
