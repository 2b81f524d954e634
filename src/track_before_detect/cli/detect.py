"""``tbd detect``: find trajectories in a recording."""

from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
import dataclasses
from pathlib import Path
import sys
import time
from typing import Any, TextIO, TYPE_CHECKING

import numpy as np

from track_before_detect import __version__
from track_before_detect.capabilities import check_options
from track_before_detect.checks import checked_number
from track_before_detect.cli.arguments.results import (
    add_result_arguments,
    check_inputs_stay,
    wanted_files,
)
from track_before_detect.cli.console import (
    add_output_argument,
    add_set_argument,
    assignments,
    BAD_INPUT,
    check_apart,
    check_output_folder,
    error_words,
    fail,
    FOUND,
    NOTHING_FOUND,
    option_lines,
    PrintAndExit,
    Progress,
    table,
    trajectory_cells,
    trajectory_header,
)
from track_before_detect.errors import DataError, MissingExtraError, ParameterError, TbdError
from track_before_detect.options import (
    describe,
    DetectorOptions,
    DETECTORS,
    is_neutral,
    parse_option,
)
from track_before_detect.parallel import map_in_threads
from track_before_detect.recordings.open_recording import expand_inputs
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.folder import summary_of, Wanted, write_folder
from track_before_detect.results.found import Found
from track_before_detect.results.json_lines import json_lines
from track_before_detect.results.saved import Opened
from track_before_detect.types import DetectionResult, STATUSES, Trajectory

if TYPE_CHECKING:
    from track_before_detect.tracking.recording import SharedSearch

# Rejected candidates that are printed, and those below the threshold that are told of.
MOST_LISTED, MOST_BELOW = 20, 20
# Has a recording searched by others, told the options and (H, W) of its frames.
Share = Callable[[DetectorOptions, tuple[int, int]], 'SharedSearch']

HELP = 'find trajectories in recordings'
DESCRIPTION = (
    'Find trajectories in a recording, print them and write to DIR (of several\n'
    'inputs to DIR/NAME, with one line for each):\n'
    '  trajectories.csv  one row per trajectory and frame\n'
    '  summary.json      options, threshold, counts\n'
    '  overlay.png       the trajectories over the middle frame, and over time\n'
    '  rejected.csv      with --explain: the candidates that are none, each with its reason\n'
    'and what --formats and --video ask for.')
EXAMPLES = """\
examples:
  a recording of a camera or a radar, as it is:
    tbd detect flight.mp4
  the same with candidates that are no target, each with its reason:
    tbd detect flight.mp4 --explain
  targets of up to 8 pixels per frame at 25 frames per second, 2 pixels wide:
    tbd detect pan.npz --set max_speed_px_s=200 --set psf_sigma_px=1
  a folder of images taken at 25 frames per second, and many recordings at once:
    tbd detect frames/ --fps 25
    tbd detect 'flights/*.mp4' night.npz --output results
  a night of recordings on all cores; begun again, it goes on where it stopped:
    tbd detect 'night/*.fits' --output results --scheduler local
  a film of it, and what other programs read:
    tbd detect flight.mp4 --video overlay.mp4 --formats mot,coco
    tbd detect flight.mp4 --json - | jq .properties.snr
  one topic of a bag, with options from a file:
    tbd detect my_bag/ --topic /camera/image_raw --config detector.yaml

All options, with units and ranges: tbd detect --list-options
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)
    add_output_argument(parser)
    parser.add_argument('--explain', action='store_true',
                        help='list candidates that were rejected, and why (calibration=clutter)')
    add_result_arguments(parser)
    add_worker_arguments(parser)
    parser.add_argument(
        '--list-options', action=PrintAndExit,
        text=lambda: '\n'.join(option_lines(option, 'auto') for option in describe()),
        help='list every option with its unit, range and meaning')


def add_worker_arguments(parser: Any) -> None:
    """Add who searches several recordings, or parts of one, at a time."""
    parser.add_argument('--scheduler', metavar='WHERE',
                        help='search several recordings, or parts of a long one, at a time: local '
                        'on the cores of this machine, or tcp://HOST:8786 on the workers of that '
                        'Dask scheduler, which have to see the recordings and DIR under the same '
                        'names; what an earlier run has finished is kept')
    parser.add_argument('--jobs', metavar='N', type=int,
                        help='workers of --scheduler local (default: one per core)')


def check_workers(arguments: Namespace) -> None:
    """Refuse a number of workers where there are none."""
    if arguments.jobs is not None and arguments.scheduler is None:
        raise ParameterError(f'--jobs {arguments.jobs} is the number of workers of --scheduler, '
                             'which was not given: --scheduler local takes the cores of this '
                             'machine')


def add_input_arguments(parser: Any) -> None:
    """Add what is searched, and with which options."""
    parser.add_argument(
        'inputs', metavar='INPUT', nargs='+',
        help="recordings, or patterns such as '*.npz': .npz (array frames (T, H, W); optional "
        'stamps in seconds, or fps), .npy, a folder of images or FITS files, a multi-page TIFF, a '
        'FITS cube, a video, Zarr (a folder, or .zip), or a bag (folder, .db3, .mcap or .bag)')
    parser.add_argument('--detector', metavar='NAME',
                        help=f'method, one of: {", ".join(DETECTORS)} (default: {DETECTORS[0]})')
    parser.add_argument('--config', metavar='FILE',
                        help='YAML file with options, flat or as ROS parameters; --detector and '
                        '--set override it')
    parser.add_argument('--preset', metavar='NAME',
                        help='options for a kind of sensor, which --config, --set and --detector '
                        'override one by one: auto looks at the first frames (default, unless '
                        'preset is in the file); none, eoir_static, eoir_moving, '
                        'radar_range_doppler, radar_range_bearing, astronomy')
    add_set_argument(parser, 'set one option; may be repeated')
    parser.add_argument('--topic', metavar='NAME', help='topic of a bag')
    parser.add_argument('--fps', metavar='RATE', type=float,
                        help='frames per second, in place of the stamps of the input; without '
                        'either, 1 frame is taken as 1 s')


def run(arguments: Namespace) -> int:
    """Search the recordings, print what was found and write the files; return the exit code."""
    told = told_options(arguments)
    check_workers(arguments)
    check_output_folder(Path(arguments.output))
    wanted = wanted_files(arguments)
    paths = expand_inputs(arguments.inputs)
    folders = folders_of(paths, arguments)
    check_inputs_stay(paths, folders, wanted.names(arguments.explain))
    check_apart(paths, folders)
    # Where lines of JSON are asked for, other programs read what is printed.
    words = sys.stderr if arguments.json else sys.stdout
    if arguments.scheduler is not None and len(paths) > 1:
        from track_before_detect.cli.spread.recordings import search_on_workers
        return search_on_workers(paths, arguments, told, words)
    if len(paths) > 1:
        return exit_code([said_of(path, output, outcome_of(
            path, output, arguments, told, wanted), words)
            for path, output in zip(paths, folders_of(paths, arguments), strict=True)])
    with ExitStack() as stack:
        share = None
        if arguments.scheduler is not None:
            from track_before_detect.cli.spread.spans import on_workers
            share = stack.enter_context(on_workers(
                Opened(paths[0], arguments.topic, arguments.fps), arguments))
        said = _search(paths[0], Path(arguments.output), arguments, told, wanted, share)
    sys.stdout.writelines(said.lines)
    print(said.text, file=words)
    print(f'written: {", ".join(map(str, said.written))}', file=words, flush=True)
    if said.failed:
        return fail('tbd', '; '.join(said.failed))
    return FOUND if said.n_found else NOTHING_FOUND


def outcome_of(path: Path, output: Path, arguments: Namespace, told: Mapping[str, Any],
               wanted: Wanted) -> dict[str, Any]:
    """Search one of several recordings into a folder of its own, whatever becomes of it.

    Returns an ``error`` or the number of trajectories ``found``, with the names of the files
    ``written`` and the ``lines`` of JSON that are asked for; both where a picture or film of what
    was found cannot be made. JSON can hold it.
    """
    try:
        said = _search(path, output, arguments, told, wanted)
    except (TbdError, OSError, MemoryError) as error:
        return {'error': error_words(error)}
    outcome = {'found': said.n_found, 'written': [file.name for file in said.written],
               'lines': said.lines}
    return {**outcome, 'error': '; '.join(said.failed)} if said.failed else outcome


def said_of(path: Path, output: Path, outcome: Mapping[str, Any], words: TextIO) -> int:
    """Say what came of one of several recordings; return its exit code."""
    count = outcome.get('found')
    if count is not None:
        found = 'no trajectory' if not count else '1 trajectory' if count == 1 else (
            f'{count} trajectories')
        sys.stdout.writelines(outcome['lines'])
        print(f'{path}: {found}, written: {output}', flush=True, file=words)
    if 'error' in outcome:
        said = outcome['error']
        return fail('tbd', said if path.name in said else f'{path}: {said}')
    return FOUND if count else NOTHING_FOUND


def exit_code(codes: Iterable[int]) -> int:
    """Return the exit code of several recordings."""
    found = set(codes)
    return next(code for code in (BAD_INPUT, FOUND, NOTHING_FOUND) if code in found)


def folders_of(paths: Sequence[Path], arguments: Namespace) -> list[Path]:
    """Return where the results of each recording go; those of a single one beside nothing else."""
    output = Path(arguments.output)
    return [output] if len(paths) == 1 else [output / name for name in _names(paths)]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return what to call the results of each recording, as short as tells them apart."""
    whole = [path.resolve() for path in paths]
    for names in ([path.name if path.is_dir() else path.stem for path in whole],
                  [path.name for path in whole]):
        if len(set(names)) == len(names):
            return names
    return [str(path.relative_to(path.anchor)) for path in whole]


@dataclasses.dataclass(frozen=True)
class _Said:
    """What there is to say of a search.

    Attributes
    ----------
    n_found : int
        Trajectories.
    text : str
        What was found.
    written : list of Path
    failed : list of str
        What is wrong with the files that could not be written.
    lines : list of str
        Of JSON, if asked for.
    """

    n_found: int
    text: str
    written: list[Path]
    failed: list[str]
    lines: list[str]


def _search(path: Path, output: Path, arguments: Namespace, told: Mapping[str, Any],
            wanted: Wanted, share: Share | None = None) -> _Said:
    """Search one recording, alone or as ``share`` has it, and write the files."""
    started = time.perf_counter()
    source = Opened(path, arguments.topic, arguments.fps)
    with source.open() as recording:
        result, options = search(recording, arguments, told, share)
        found = Found(recording, options, result)
        summary = summary_of(found, time.perf_counter() - started, __version__, source,
                             wanted.names(arguments.explain))
        rejected = numbered(result) if arguments.explain else None
        with Progress.asked_for(arguments) as progress:
            written, failed = write_folder(output, found, summary, wanted, rejected, progress)
        lines = list(json_lines(found)) if arguments.json else []
        words = [_table(result.trajectories, recording.stamps_known), *_closing_words(result)]
        if rejected is not None:
            words.append(_explanation(rejected, result, recording.stamps_known))
        elif n_above(result) or (result.rejected and not result.trajectories):
            words.append(_hint(result))
        return _Said(len(result.trajectories), '\n'.join(words), written, failed, lines)


def search(recording: Recording, arguments: Namespace, told: Mapping[str, Any],
           share: Share | None = None, **observe: Any) -> tuple[DetectionResult, DetectorOptions]:
    """Search a recording with the options of a preset; errors name it."""
    options, reasons = chosen_options(recording, arguments, told)
    from track_before_detect.tracking.recording import detect_recording

    if share is not None:
        observe['shared'] = share(options, recording.shape)
    with Progress.asked_for(arguments, every=share is not None) as progress:
        try:
            # In a thread of its own, which an interrupt does not wait for.
            [result] = map_in_threads(
                lambda frames: detect_recording(frames, options, progress, reasons=reasons,
                                                over_all_frames=False, **observe),
                [recording], progress.show_time)
        except DataError as error:
            raise DataError(f'{recording.name} cannot be searched: {error}') from error
    return result, options


def chosen_options(recording: Recording, arguments: Namespace, told: Mapping[str, Any],
                   ) -> tuple[DetectorOptions, list[str]]:
    """Return the options of the preset with those that are told, and the reasons, which are said.

    Refuses recordings that are too short or too large before they are read.
    """
    if len(recording) < 2:
        raise DataError(
            f'{recording.name} must hold at least 2 frames to show a motion, got 1')
    # Compiled loops take a second to load; errors of the input need not wait for them.
    from track_before_detect.tracking.batcher import check_batch_size, length_of
    from track_before_detect.tracking.presets import choose_for

    check_batch_size(recording.name, recording.shape, len(recording),
                     DetectorOptions.from_mapping(told).batch_length)
    options, reasons = choose_for(recording, arguments.preset, told)
    for reason in reasons if not arguments.quiet else ():
        print(f'preset {arguments.preset}: {reason}', file=sys.stderr)
    if options.batch_length is None:
        options = options.replace(batch_length=length_of(len(recording)))
    return options, reasons


def told_options(arguments: Namespace) -> dict[str, Any]:
    """Return the options of the file, overridden by those of the command line, checked."""
    if arguments.fps is not None:
        checked_number('--fps', arguments.fps, above=0)
    values: dict[str, Any] = {}
    if arguments.config is not None:
        values.update(_read_config(Path(arguments.config)))
    for key, text in assignments(arguments.set).items():
        values[key] = parse_option(key, text)
    if arguments.detector is not None:
        values['detector'] = arguments.detector
    named = values.pop('preset', 'auto')
    arguments.preset = arguments.preset or named
    options = DetectorOptions.from_mapping(values)
    if arguments.preset == 'none':
        # Those of another preset may be what goes with what was told.
        check_options(options)
    return values


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
    except RecursionError as error:
        raise DataError(f'--config {path} is not YAML with options: too many brackets within one '
                        'another') from error
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


def _options_among_parameters(path: Path, parameters: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the detector's options among the parameters of a node."""
    optional = {'preset': False, **{o['name']: o['optional'] for o in describe()}}
    others = [str(name) for name in parameters if name not in optional]
    if others:
        print(f'tbd: note: {path} also holds parameters of the node, not used here: '
              f'{", ".join(others)}', file=sys.stderr)
    return {name: None if optional[name] and is_neutral(value) else value
            for name, value in parameters.items() if name in optional}


def _closing_words(result: DetectionResult) -> list[str]:
    """Return what there is to say of how the search ended, and of what it has not found."""
    words = []
    if result.status != 'converged':
        words.append(f'status {result.status}: {STATUSES[result.status]}')
        words += result.remarks if result.status == 'not_noise' else []
    if not result.trajectories and np.isfinite(result.best_statistic):
        given = result.threshold_source == 'given'
        words.append(
            f'the best path has a statistic of {result.best_statistic:.2f}, the threshold is '
            f'{result.threshold:.2f}{"" if given else ": a larger false_alarm_rate lowers it"}')
    return words


def numbered(result: DetectionResult) -> list[Trajectory]:
    """Return the candidates worth telling, numbered by descending statistic.

    All that passed the threshold and were rejected, and the strongest of those that did not.
    """
    ordered = sorted(result.rejected, key=lambda candidate: -candidate.statistic)
    kept = ordered[:n_above(result) + MOST_BELOW]
    return [dataclasses.replace(one, id=number) for number, one in enumerate(kept, 1)]


def n_above(result: DetectionResult) -> int:
    """Return how many candidates passed the threshold and were rejected."""
    return sum(one.statistic > result.threshold for one in result.rejected)


def _hint(result: DetectionResult) -> str:
    """Return how many candidates were rejected, or how near the threshold the best came."""
    count = n_above(result)
    if not count:
        strongest = max(one.statistic for one in result.rejected) / result.threshold
        return (f'the strongest candidate reaches {strongest:.2f} of the threshold: '
                'tbd detect --explain lists more')
    return f'{count} candidate{"s" * (count > 1)} rejected: tbd detect --explain lists them'


def _explanation(rejected: Sequence[Trajectory], result: DetectionResult,
                 stamps_known: bool) -> str:
    """Return the strongest rejected candidates as text, relative to the threshold."""
    if not rejected:
        return 'no candidate rejected (calibration=clutter looks for reasons)'
    count = n_above(result)
    shown = rejected[:MOST_LISTED]
    lines = table([[*trajectory_header(stamps_known), 'statistic/threshold', 'reason'],
                   *([*trajectory_cells(one), f'{one.statistic / result.threshold:.2f}',
                      one.reason] for one in shown)])
    more = len(rejected) - len(shown)
    return (f'candidates that are no targets ({count} above the threshold):\n{lines}'
            + (f'\n… and {more} more in rejected.csv' if more else ''))


def _table(trajectories: Sequence[Trajectory], stamps_known: bool) -> str:
    """Return the trajectories as text, one line each."""
    if not trajectories:
        return 'no trajectory found'
    return table([[*trajectory_header(stamps_known), 'statistic'],
                  *([*trajectory_cells(trajectory), f'{trajectory.statistic:.2f}']
                    for trajectory in trajectories)])
