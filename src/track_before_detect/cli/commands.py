"""The command ``tbd``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
import dataclasses
import importlib.util
import io
import logging
import os
from pathlib import Path
import shlex
import signal
import sys
import tempfile
import textwrap
import threading
import time
from typing import Any, TextIO

import numpy as np

from track_before_detect import __version__
from track_before_detect.errors import DataError, MissingExtraError, ParameterError, TbdError
from track_before_detect.options import describe, DetectorOptions, DETECTORS, parse_option
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.overlay import write_overlay
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.result_files import write_summary_json, write_trajectories_csv
from track_before_detect.simulation.scenarios import Scenario, SCENARIOS, simulate
from track_before_detect.types import DetectionResult, Trajectory

FOUND, BAD_INPUT, NOTHING_FOUND, INTERRUPTED, TERMINATED = 0, 2, 3, 130, 143

_MAIN_EXAMPLES = """\
try it:
  tbd simulate eo_ir_drones --seed 1 --output drones.npz
  tbd detect drones.npz --output drones

exit codes:
  0  done and something found (or nothing to find)
  2  an input or option cannot be used; one sentence on stderr says why
  3  done and nothing found
  130  interrupted with Ctrl-C
  143  ended by the signal TERM
"""

_DETECT_EXAMPLES = """\
examples:
  a recording whose noise level is not known (most cameras):
    tbd detect flight.npz --set noise=robust --set background=temporal_median
  a camera that moves, targets of up to 3 pixels per frame at 25 frames per second:
    tbd detect pan.npz --set registration=translation --set max_speed_px_s=75 \\
        --set background=temporal_median --set noise=map
  one topic of a bag, with options from a file:
    tbd detect my_bag/ --topic /camera/image_raw --config detector.yaml

All options, with units and ranges: tbd detect --list-options
"""

_SIMULATE_EXAMPLES = """\
examples:
  tbd simulate --list
  tbd simulate three_targets --seed 7 --output three.npz
  tbd simulate crossing --seed 7 --set snr=2.5 --set n_frames=40 --output crossing.npz
"""

_EVALUATE_EXAMPLES = """\
examples:
  tbd evaluate --list
  tbd evaluate detection --runs 200 --seed 1 --output evaluation
  tbd evaluate ring-single --runs 20 --output ring --jobs 4
  on a cluster (joblib's Dask or Ray backend):
    tbd evaluate ring-single --runs 1000 --output ring --backend dask --scheduler tcp://host:8786
"""

_BENCH_EXAMPLES = """\
examples:
  tbd bench convex --output bench.json
  tbd bench dp --output dp.json
  on one core only, where the system has taskset:
    taskset -c 0 tbd bench convex --output one_core.json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    logging.basicConfig(format='tbd: %(levelname)s: %(message)s', level=logging.WARNING)
    _prepare_output()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminate)
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output, such as head, has seen enough; closing must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FOUND
    except KeyboardInterrupt:
        print('tbd: interrupted', file=sys.stderr)
        return INTERRUPTED
    except (TbdError, OSError) as error:
        return _fail(str(error))
    except MemoryError:
        return _fail('not enough memory for this recording; a smaller batch_length needs less')


def _prepare_output():
    """Let nothing that is printed fail for want of a stream or of a character."""
    for name in ('stdout', 'stderr'):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, 'w', encoding='utf-8'))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def _terminate(*_):
    """End like an error does, so that no half-written file stays."""
    sys.exit(TERMINATED)


def _run(arguments):
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return BAD_INPUT
    return options.run(options)


def _fail(message):
    print(f'tbd: error: {" ".join(message.split())}', file=sys.stderr)
    return BAD_INPUT


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one sentence, like every other error of the command."""

    def error(self, message):
        self.exit(_fail(f'{message} (see {self.prog} --help)'))


class _ListOptions(argparse.Action):
    """Print all options of the detector and exit."""

    def __init__(self, option_strings, dest, **kwargs):
        super().__init__(option_strings, dest, nargs=0, **kwargs)

    def __call__(self, parser, *_):
        for option in describe():
            print(_option_lines(option, 'auto'))
        parser.exit()


class _ListScenarios(argparse.Action):
    """Print all scenarios and their parameters and exit."""

    def __init__(self, option_strings, dest, **kwargs):
        super().__init__(option_strings, dest, nargs=0, **kwargs)

    def __call__(self, parser, *_):
        print('Scenarios:')
        for name, scenario in SCENARIOS.items():
            print(f'  {name}\n{_indented(scenario.description)}')
            differences = _differences(scenario)
            if differences:
                print(_indented(differences))
        print('\nParameters of every scenario (--set KEY=VALUE):')
        for field in dataclasses.fields(Scenario):
            if field.metadata:
                option = {'name': field.name, 'default': field.default, **field.metadata}
                print(_option_lines(option, ''))
        parser.exit()


class _ListSuites(argparse.Action):
    """Print all suites and exit."""

    def __init__(self, option_strings, dest, **kwargs):
        super().__init__(option_strings, dest, nargs=0, **kwargs)

    def __call__(self, parser, *_):
        from track_before_detect.evaluation.studies.registry import SUITES
        for name, suite in SUITES.items():
            print(f'  {name}\n{_indented(suite.description)}')
        parser.exit()


def _parser():
    parser = _Parser(
        prog='tbd', epilog=_MAIN_EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Find dim moving targets in sequences of frames where no single frame shows '
        'them\n(track-before-detect).')
    parser.add_argument('--version', action='version', version=f'tbd {__version__}')
    parser.set_defaults(command=None)
    commands = parser.add_subparsers(title='commands', metavar='COMMAND', dest='command')
    _add_detect(commands)
    _add_simulate(commands)
    _add_evaluate(commands)
    _add_bench(commands)
    return parser


def _add_detect(commands):
    detect = commands.add_parser(
        'detect', help='find trajectories in a recording', epilog=_DETECT_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Find trajectories in a recording, print them and write to DIR:\n'
        '  trajectories.csv  one row per trajectory and frame\n'
        '  summary.json      options, threshold, counts\n'
        '  overlay.png       the trajectories over the middle frame, and over time')
    detect.set_defaults(run=_detect)
    detect.add_argument(
        'input', metavar='INPUT',
        help='.npz (array frames (T, H, W); optional stamps in seconds, or fps), a folder of '
        'images, a multi-page TIFF, a FITS cube, or a rosbag2 (folder, .db3 or .mcap)')
    detect.add_argument('--detector', metavar='NAME',
                        help=f'method, one of: {", ".join(DETECTORS)} (default: {DETECTORS[0]})')
    detect.add_argument('--config', metavar='FILE',
                        help='YAML file with options, flat or as ROS parameters; --detector and '
                        '--set override it')
    detect.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                        help='set one option; may be repeated')
    detect.add_argument('--topic', metavar='NAME', help='topic of a bag')
    detect.add_argument('--output', metavar='DIR', default='output',
                        help='folder for the results, made when missing; files of an earlier run '
                        'are replaced (default: output)')
    detect.add_argument('--no-overlay', action='store_true',
                        help='do not draw overlay.png (no matplotlib needed)')
    detect.add_argument('--list-options', action=_ListOptions,
                        help='list every option with its unit, range and meaning')


def _add_simulate(commands):
    simulate_parser = commands.add_parser(
        'simulate', help='make a recording with known targets', epilog=_SIMULATE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Make a recording with known targets and write it as .npz with frames, '
        'stamps and\ntruth rows [frame, id, x, y].')
    simulate_parser.set_defaults(run=_simulate)
    simulate_parser.add_argument('scenario', metavar='SCENARIO',
                                 help=f'one of: {", ".join(SCENARIOS)}')
    simulate_parser.add_argument('--seed', metavar='S', type=int, default=0,
                                 help='the same seed gives the same recording (default: 0)')
    simulate_parser.add_argument('--output', metavar='FILE.npz',
                                 help='file to write (default: SCENARIO.npz)')
    simulate_parser.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                                 help='set one parameter of the scenario; may be repeated')
    simulate_parser.add_argument('--list', action=_ListScenarios,
                                 help='list the scenarios and their parameters')


def _add_evaluate(commands):
    evaluate = commands.add_parser(
        'evaluate', help='repeat a study over many simulated recordings',
        epilog=_EVALUATE_EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Repeat a study over many simulated recordings, print its table and write to '
        'DIR:\n'
        '  report.md     the table with 95 % intervals, and the command that made it\n'
        '  SUITE.csv     one row per run\n'
        '  SUITE.png     the picture of the report\n'
        '  summary.json  the table with settings and machine\n'
        '  runs.jsonl    single results: the same command continues from them after an\n'
        '                interruption, and one with more runs adds to them; may be deleted')
    evaluate.set_defaults(run=_evaluate)
    evaluate.add_argument('suite', metavar='SUITE', help='name of the study; see --list')
    evaluate.add_argument('--runs', metavar='N', type=int, default=100,
                          help='how often it is repeated (default: 100)')
    evaluate.add_argument('--seed', metavar='S', type=int, default=0,
                          help='the same seed gives the same recordings (default: 0)')
    evaluate.add_argument('--output', metavar='DIR', default='evaluation',
                          help='folder for the results, made when missing; files of an earlier '
                          'run are replaced (default: evaluation)')
    evaluate.add_argument('--jobs', metavar='N', type=int,
                          help='runs at a time (default: one per core with joblib, else one)')
    evaluate.add_argument('--backend', metavar='NAME', default='loky',
                          help='backend of joblib that carries out the runs: loky (default), '
                          'threading, multiprocessing, dask, ray')
    evaluate.add_argument('--scheduler', metavar='ADDRESS',
                          help='address of a Dask scheduler or a Ray cluster; without it dask and '
                          'ray start workers on this machine')
    evaluate.add_argument('--list', action=_ListSuites, help='list the suites')


def _add_bench(commands):
    bench = commands.add_parser(
        'bench', help='measure time and memory on this machine', epilog=_BENCH_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Measure time and memory of a detector on simulated frames, stage by stage; '
        'print a\ntable and write it as JSON with a description of the machine.')
    bench.set_defaults(run=_bench)
    bench.add_argument('bench', metavar='BENCH', nargs='?', default='convex',
                       help='what is measured: convex (default); dp, dynamic programming beside '
                       'plain NumPy; fit, amplitudes of thousands of given paths; parallel, '
                       'target cancellation by direction; velocity_filter, beside plain NumPy')
    bench.add_argument('--output', metavar='FILE.json', default='bench.json',
                       help='file to write (default: bench.json)')
    bench.add_argument('--repeats', metavar='R', type=int, default=7,
                       help='measurements of each stage (default: 7)')
    bench.add_argument('--large', action='store_true',
                       help='also measure larger frames; convex then takes minutes and several '
                       'gigabytes')


def _evaluate(arguments):
    from track_before_detect.evaluation.engine.kept_results import KeptResults
    from track_before_detect.evaluation.engine.report import (
        require_matplotlib,
        table_text,
        write_suite_result,
    )
    from track_before_detect.evaluation.engine.runner import Runner, Workers
    from track_before_detect.evaluation.studies.registry import suite_named

    suite = suite_named(arguments.suite)
    output = Path(arguments.output)
    workers = Workers(arguments.jobs, arguments.backend, arguments.scheduler)
    _check_folder(output)
    require_matplotlib()
    command = shlex.join(['tbd', 'evaluate', arguments.suite, '--runs', str(arguments.runs),
                          '--seed', str(arguments.seed), '--output', arguments.output])
    with _Progress(sys.stderr) as progress:
        result = suite.run(arguments.runs, arguments.seed, Runner(
            progress, workers, KeptResults(output / 'runs.jsonl')))
    written = write_suite_result(output, arguments.suite, result, command)
    print(table_text(result.quantities))
    print(f'written: {", ".join(map(str, written))}')
    return FOUND


def _bench(arguments):
    from track_before_detect.evaluation.benchmarks.registry import bench_named

    bench = bench_named(arguments.bench)
    output = Path(arguments.output)
    if output.suffix != '.json':
        raise ParameterError(f'--output must end with .json, got {output}')
    if not output.parent.is_dir():
        raise ParameterError(f'folder {output.parent} of --output does not exist')
    with _Progress(sys.stderr) as progress:
        measured = bench.measure(arguments.repeats, arguments.large, progress)
    write_summary_json(output, measured)
    print(bench.table(measured))
    print(f'written: {output}')
    return FOUND


def _simulate(arguments):
    output = Path(arguments.output or f'{arguments.scenario}.npz')
    if output.suffix != '.npz':
        raise ParameterError(f'--output must end with .npz, got {output}')
    made = simulate(arguments.scenario, arguments.seed, **dict(map(_key_value, arguments.set)))
    if not output.parent.is_dir():
        raise ParameterError(f'folder {output.parent} of --output does not exist')
    write_npz_recording(output, made.frames, made.stamps, made.truth)
    scenario = made.scenario
    targets = f'{scenario.n_targets} target{"" if scenario.n_targets == 1 else "s"}'
    print(f'{output}: {scenario.n_frames} frames of {scenario.height} x {scenario.width} px at '
          f'{scenario.fps:g} Hz, {targets}')
    return FOUND


def _detect(arguments):
    options = _detector_options(arguments)
    output = Path(arguments.output)
    _check_output(output, overlay=not arguments.no_overlay)
    started = time.perf_counter()
    with open_recording(arguments.input, arguments.topic) as recording:
        if len(recording) < 2:
            raise DataError(
                f'{recording.name} must hold at least 2 frames to show a motion, got 1')
        # Compiled loops take a second to load; errors of the input need not wait for them.
        from track_before_detect.tracking.recording import detect_recording

        with _Progress(sys.stderr) as progress:
            try:
                result = detect_recording(recording, options, progress)
            except DataError as error:
                raise DataError(f'{recording.name} cannot be searched: {error}') from error
        seconds = time.perf_counter() - started
        summary = _summary(recording, options, result, seconds)
        written = _write_results(output, recording, result, summary,
                                 overlay=not arguments.no_overlay)
    print(_table(result.trajectories))
    print(f'written: {", ".join(map(str, written))}')
    return FOUND if result.trajectories else NOTHING_FOUND


def _detector_options(arguments) -> DetectorOptions:
    """Return the options of the file, overridden by those of the command line."""
    values: dict[str, Any] = {}
    if arguments.config is not None:
        values.update(_read_config(Path(arguments.config)))
    for key, text in map(_key_value, arguments.set):
        values[key] = parse_option(key, text)
    if arguments.detector is not None:
        values['detector'] = arguments.detector
    return DetectorOptions.from_mapping(values)


def _key_value(text):
    key, separator, value = text.partition('=')
    if not separator or not key.strip():
        raise ParameterError(f'--set needs KEY=VALUE, got {text!r}')
    return key.strip(), value.strip()


def _read_config(path: Path) -> dict[str, Any]:
    """Return the options in a YAML file, flat or nested like a file of ROS parameters."""
    try:
        import yaml
    except ImportError as error:
        raise MissingExtraError(
            "--config needs PyYAML: pip install 'track_before_detect[cli]'") from error
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise DataError(f'--config {path} cannot be read: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DataError(f'--config {path} is not YAML: {error}') from error
    if content is None:
        return {}
    if not isinstance(content, Mapping):
        raise DataError(f'--config {path} must hold names and values, got a '
                        f'{type(content).__name__}')
    nodes = [node['ros__parameters'] for node in content.values()
             if isinstance(node, Mapping) and 'ros__parameters' in node]
    if not nodes:
        return dict(content)
    if len(nodes) > 1 or not isinstance(nodes[0], Mapping):
        raise DataError(f'--config {path} must hold the ros__parameters of one node')
    return _options_among_parameters(path, nodes[0])


def _options_among_parameters(path, parameters):
    """Return the detector's options among the parameters of a node."""
    optional = {option['name']: option['optional'] for option in describe()}
    others = [str(name) for name in parameters if name not in optional]
    if others:
        print(f'tbd: note: {path} also holds parameters of the node, not used here: '
              f'{", ".join(others)}', file=sys.stderr)
    # ROS parameters cannot be empty: there 0, '' and [] stand for automatic.
    return {name: None if optional[name] and value in (0, '', []) else value
            for name, value in parameters.items() if name in optional}


def _check_output(output, overlay):
    """Refuse before the work what could not be written after it."""
    _check_folder(output)
    if overlay and importlib.util.find_spec('matplotlib') is None:
        raise MissingExtraError(
            "overlay.png needs matplotlib: pip install 'track_before_detect[plots]', or give "
            '--no-overlay')


def _check_folder(output):
    """Refuse a folder that could not be made or written to."""
    existing = output
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise ParameterError(f'--output must be a folder, but {existing} is a file')
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ParameterError(f'--output {output} cannot be written: no permission in {existing}')


def _summary(recording: Recording, options, result: DetectionResult, seconds) -> dict[str, Any]:
    interval = np.diff(recording.stamps)
    return {
        'input': recording.name,
        'n_frames': len(recording),
        'n_batches': result.n_batches,
        'height_px': recording.shape[0],
        'width_px': recording.shape[1],
        'stamps_known': recording.stamps_known,
        'median_interval_s': float(np.median(interval)) if len(interval) else None,
        'detector': options.detector,
        'options': dataclasses.asdict(options),
        'status': result.status,
        'threshold': result.threshold,
        'gap': result.gap,
        'n_trajectories': len(result.trajectories),
        'seconds': round(seconds, 3),
        'version': __version__,
    }


def _write_results(output: Path, recording, result, summary, overlay) -> list[Path]:
    """Write all files aside, then move them to their place together."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output, prefix='.partial-') as folder:
        aside = Path(folder)
        write_trajectories_csv(aside / 'trajectories.csv', result.trajectories)
        if overlay:
            middle = len(recording) // 2
            write_overlay(aside / 'overlay.png', recording[middle], result.trajectories,
                          recording.truth, f'{recording.name}, frame {middle}', middle)
        write_summary_json(aside / 'summary.json', summary)
        files = sorted(aside.iterdir())
        for file in files:
            os.replace(file, output / file.name)
        return [output / file.name for file in files]


def _table(trajectories: Sequence[Trajectory]) -> str:
    """Return the trajectories as text, one line each."""
    if not trajectories:
        return 'no trajectory found'
    rows = [('id', 'frames', 'first x, y [px]', 'last x, y [px]', 'speed [px/s]', 'snr',
             'statistic')]
    for trajectory in trajectories:
        present = np.flatnonzero(np.isfinite(trajectory.positions).all(axis=1))
        frames = trajectory.frame_indices[present]
        first, last = trajectory.positions[present[0]], trajectory.positions[present[-1]]
        speeds = np.hypot(*trajectory.velocity[present].T)
        speeds = speeds[np.isfinite(speeds)]
        rows.append((
            str(trajectory.id), f'{frames[0]}-{frames[-1]}', f'{first[0]:.1f}, {first[1]:.1f}',
            f'{last[0]:.1f}, {last[1]:.1f}', f'{speeds.mean():.2f}' if len(speeds) else '-',
            f'{trajectory.snr:.2f}', f'{trajectory.statistic:.2f}'))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
                     for row in rows)


def _option_lines(option, automatic):
    """Return the description of one option."""
    default = option['default']
    shown = automatic if default is None else (
        ','.join(f'{value:g}' for value in default) if isinstance(default, tuple) else default)
    limits = [f'{sign} {option[key]:g}' for key, sign in
              (('above', '>'), ('minimum', '>='), ('maximum', '<=')) if option[key] is not None]
    facts = [f'default {shown}', *limits]
    if option['choices']:
        facts.append('one of ' + ', '.join(option['choices']))
    unit = f' [{option["unit"]}]' if option['unit'] else ''
    return f'  {option["name"]}{unit}: {"; ".join(facts)}\n{_indented(option["description"])}'


def _indented(text):
    return textwrap.fill(text, 96, initial_indent=' ' * 6, subsequent_indent=' ' * 6)


def _differences(scenario):
    """Return what makes a scenario differ from the defaults of its parameters."""
    return ', '.join(f'{field.name}={getattr(scenario, field.name)}'
                     for field in dataclasses.fields(Scenario)
                     if field.metadata and getattr(scenario, field.name) != field.default)


class _Progress:
    """Shows progress: a bar on a terminal, otherwise one line per task."""

    def __init__(self, stream: TextIO):
        self._stream = stream
        self._label = ''
        self._announced: set[str] = set()
        self._bar: Any = None
        self._new_bar: Callable[..., Any] | None = None
        if stream.isatty() and importlib.util.find_spec('tqdm') is not None:
            from tqdm import tqdm
            self._new_bar = tqdm

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._close()

    def __call__(self, label: str, done: float) -> None:
        """Show that the share ``done`` (0..1) of the task ``label`` is done."""
        if label != self._label:
            self._close()
            self._label = label
            if self._new_bar is None:
                # Every batch may go through the same tasks again.
                if label not in self._announced:
                    print(f'tbd: {label}', file=self._stream, flush=True)
                    self._announced.add(label)
            else:
                self._bar = self._new_bar(
                    total=1.0, desc=label, file=self._stream, leave=False,
                    bar_format='{desc}: {percentage:3.0f} %|{bar}| {elapsed}')
        if self._bar is not None:
            self._bar.update(min(max(done, 0.0), 1.0) - self._bar.n)

    def _close(self):
        if self._bar is not None:
            self._bar.close()
            self._bar = None


if __name__ == '__main__':
    sys.exit(main())
