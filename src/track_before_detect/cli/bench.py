"""``tbd bench``: measure time and memory on this machine."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from track_before_detect.cli.console import check_output_file, FOUND, Progress
from track_before_detect.recordings.result_files import write_summary_json

HELP = 'measure time and memory on this machine'
DESCRIPTION = (
    'Measure time and memory of a detector on simulated frames, stage by stage; '
    'print a\ntable and write it as JSON with a description of the machine.')
EXAMPLES = """\
examples:
  tbd bench convex --output bench.json
  tbd bench dp --output dp.json
  tbd bench scene --large --output scene.json
  on one core only, where the system has taskset:
    taskset -c 0 tbd bench convex --output one_core.json
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    parser.add_argument('bench', metavar='BENCH', nargs='?', default='convex',
                        help='what is measured: convex (default); dp, dynamic programming beside '
                        'plain NumPy; fit, amplitudes of thousands of given paths; memory, with '
                        'few states at a time; parallel, target cancellation by direction; '
                        'scene, a panning camera with preset=auto; tiles, of large frames; '
                        'velocity_filter, beside plain NumPy; compilation, of the loops from '
                        'nothing; workers, of which one is killed, beside one process')
    parser.add_argument('--output', metavar='FILE.json', default='bench.json',
                        help='file to write (default: bench.json)')
    parser.add_argument('--repeats', metavar='R', type=int, default=7,
                        help='measurements of each stage (default: 7)')
    parser.add_argument('--large', action='store_true',
                        help='also measure larger frames; convex then takes minutes and several '
                        'gigabytes')


def run(arguments: Namespace) -> int:
    """Measure, print the table and write the file; return the exit code."""
    from track_before_detect.evaluation.benchmarks.registry import bench_named

    bench = bench_named(arguments.bench)
    output = Path(arguments.output)
    check_output_file(output, '.json')
    with Progress.asked_for(arguments) as progress:
        measured = bench.measure(arguments.repeats, arguments.large, progress)
    write_summary_json(output, measured)
    print(bench.table(measured))
    print(f'written: {output}')
    return FOUND
