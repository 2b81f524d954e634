"""``tbd detect``: find trajectories in a recording."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
import dataclasses
import importlib.util
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np

from track_before_detect import __version__
from track_before_detect.atomic_files import atomic_folder
from track_before_detect.capabilities import check_options
from track_before_detect.cli.console import (
    add_set_argument,
    assignments,
    check_output_folder,
    FOUND,
    NOTHING_FOUND,
    option_lines,
    PrintAndExit,
    Progress,
    table,
    trajectory_cells,
    TRAJECTORY_HEADER,
)
from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.options import (
    describe,
    DetectorOptions,
    DETECTORS,
    is_neutral,
    parse_option,
)
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.overlay import write_overlay
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.result_files import write_summary_json, write_trajectories_csv
from track_before_detect.timestamps import increasing_frames
from track_before_detect.types import DetectionResult, Trajectory

# Rejected candidates that are printed, and those below the threshold that are told of.
MOST_LISTED, MOST_BELOW = 20, 20

_EXAMPLES = """\
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


def add_parser(commands: Any) -> None:
    """Add the command to the subparsers of ``tbd``."""
    parser = commands.add_parser(
        'detect', help='find trajectories in a recording', epilog=_EXAMPLES,
        description='Find trajectories in a recording, print them and write to DIR:\n'
        '  trajectories.csv  one row per trajectory and frame\n'
        '  summary.json      options, threshold, counts\n'
        '  overlay.png       the trajectories over the middle frame, and over time\n'
        '  rejected.csv      with --explain: the candidates that are none, each with its reason')
    parser.set_defaults(run=run)
    add_input_arguments(parser)
    parser.add_argument('--explain', action='store_true',
                        help='list candidates that were rejected, and why (calibration=clutter)')
    parser.add_argument('--no-overlay', action='store_true',
                        help='do not draw overlay.png (no matplotlib needed)')
    parser.add_argument(
        '--list-options', action=PrintAndExit,
        text=lambda: '\n'.join(option_lines(option, 'auto') for option in describe()),
        help='list every option with its unit, range and meaning')


def add_input_arguments(parser: Any) -> None:
    """Add what is searched, with which options, and where the results go."""
    parser.add_argument(
        'input', metavar='INPUT',
        help='.npz (array frames (T, H, W); optional stamps in seconds, or fps), a folder of '
        'images, a multi-page TIFF, a FITS cube, a video, or a rosbag2 (folder, .db3 or .mcap)')
    parser.add_argument('--detector', metavar='NAME',
                        help=f'method, one of: {", ".join(DETECTORS)} (default: {DETECTORS[0]})')
    parser.add_argument('--config', metavar='FILE',
                        help='YAML file with options, flat or as ROS parameters; --detector and '
                        '--set override it')
    add_set_argument(parser, 'set one option; may be repeated')
    parser.add_argument('--topic', metavar='NAME', help='topic of a bag')
    parser.add_argument('--output', metavar='DIR', default='output',
                        help='folder for the results, made when missing; files of an earlier run '
                        'are replaced (default: output)')


def run(arguments: Namespace) -> int:
    """Search the recording, print what was found and write the files; return the exit code."""
    options = detector_options(arguments)
    output, overlay = Path(arguments.output), not arguments.no_overlay
    check_output_folder(output)
    if overlay:
        require_matplotlib('overlay.png', ', or give --no-overlay')
    started = time.perf_counter()
    with open_recording(arguments.input, arguments.topic) as recording:
        with Progress(sys.stderr) as progress:
            result = search(recording, options, progress)
        seconds = time.perf_counter() - started
        summary = _summary(recording, options, result, seconds)
        rejected = numbered(result) if arguments.explain else None
        written = _write_results(output, recording, result, summary, overlay, rejected)
    print(_table(result.trajectories))
    if rejected is not None:
        print(_explanation(rejected, result))
    elif n_above(result) or (result.rejected and not result.trajectories):
        print(_hint(result))
    print(f'written: {", ".join(map(str, written))}')
    return FOUND if result.trajectories else NOTHING_FOUND


def require_matplotlib(what: str, otherwise: str = '') -> None:
    """Refuse before the work what could not be drawn after it."""
    if importlib.util.find_spec('matplotlib') is None:
        raise MissingExtraError(f"{what} needs matplotlib: pip install "
                                f"'track_before_detect[plots]'{otherwise}")


def search(recording: Recording, options: DetectorOptions, progress: Progress,
           **watch: Any) -> DetectionResult:
    """Search a recording; errors name it."""
    if len(recording) < 2:
        raise DataError(
            f'{recording.name} must hold at least 2 frames to show a motion, got 1')
    # Compiled loops take a second to load; errors of the input need not wait for them.
    from track_before_detect.tracking.recording import detect_recording

    try:
        return detect_recording(recording, options, progress, **watch)
    except DataError as error:
        raise DataError(f'{recording.name} cannot be searched: {error}') from error


def detector_options(arguments: Namespace) -> DetectorOptions:
    """Return the options of the file, overridden by those of the command line, checked."""
    values: dict[str, Any] = {}
    if arguments.config is not None:
        values.update(_read_config(Path(arguments.config)))
    for key, text in assignments(arguments.set).items():
        values[key] = parse_option(key, text)
    if arguments.detector is not None:
        values['detector'] = arguments.detector
    options = DetectorOptions.from_mapping(values)
    check_options(options)
    return options


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


def _options_among_parameters(path: Path, parameters: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the detector's options among the parameters of a node."""
    optional = {option['name']: option['optional'] for option in describe()}
    others = [str(name) for name in parameters if name not in optional]
    if others:
        print(f'tbd: note: {path} also holds parameters of the node, not used here: '
              f'{", ".join(others)}', file=sys.stderr)
    return {name: None if optional[name] and is_neutral(value) else value
            for name, value in parameters.items() if name in optional}


def _summary(recording: Recording, options: DetectorOptions, result: DetectionResult,
             seconds: float) -> dict[str, Any]:
    interval = np.diff(recording.stamps[increasing_frames(recording.stamps)])
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
        'remarks': result.remarks,
        'threshold': result.threshold,
        'gap': result.gap,
        'n_trajectories': len(result.trajectories),
        'seconds': round(seconds, 3),
        'version': __version__,
    }


def _write_results(output: Path, recording: Recording, result: DetectionResult,
                   summary: dict[str, Any], overlay: bool,
                   rejected: list[Trajectory] | None) -> list[Path]:
    """Write all files aside, then move them to their place together."""
    with atomic_folder(output) as aside:
        write_trajectories_csv(aside / 'trajectories.csv', result.trajectories)
        if rejected is not None:
            write_trajectories_csv(aside / 'rejected.csv', rejected, with_reason=True)
        if overlay:
            middle = len(recording) // 2
            write_overlay(aside / 'overlay.png', recording[middle], result.trajectories,
                          recording.truth, f'{recording.name}, frame {middle}', middle)
        write_summary_json(aside / 'summary.json', summary)
        names = sorted(file.name for file in aside.iterdir())
    return [output / name for name in names]


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


def _explanation(rejected: Sequence[Trajectory], result: DetectionResult) -> str:
    """Return the strongest rejected candidates as text, relative to the threshold."""
    if not rejected:
        return 'no candidate rejected (calibration=clutter looks for reasons)'
    count = n_above(result)
    shown = rejected[:MOST_LISTED]
    lines = table([[*TRAJECTORY_HEADER, 'statistic/threshold', 'reason'],
                   *([*trajectory_cells(one), f'{one.statistic / result.threshold:.2f}',
                      one.reason] for one in shown)])
    more = len(rejected) - len(shown)
    return (f'candidates that are no targets ({count} above the threshold):\n{lines}'
            + (f'\n… and {more} more in rejected.csv' if more else ''))


def _table(trajectories: Sequence[Trajectory]) -> str:
    """Return the trajectories as text, one line each."""
    if not trajectories:
        return 'no trajectory found'
    return table([[*TRAJECTORY_HEADER, 'statistic'],
                  *([*trajectory_cells(trajectory), f'{trajectory.statistic:.2f}']
                    for trajectory in trajectories)])
