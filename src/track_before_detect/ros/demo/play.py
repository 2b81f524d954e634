"""Play a recording to the detector over DDS and show what it finds.

``frame_publisher`` and ``detector`` run as two processes; this one listens to what they publish.
"""

from argparse import Namespace
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import sys
import time
from typing import Any, NoReturn, TextIO

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2

from track_before_detect.checks import checked_number, checked_stamps
from track_before_detect.cli.console import (
    add_output_argument,
    add_set_argument,
    assignments,
    BAD_INPUT,
    fail,
    FAILED,
    FOUND,
    NOTHING_FOUND,
    Parser,
)
from track_before_detect.errors import ParameterError, TbdError
from track_before_detect.options import DetectorOptions, parse_option
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.overlay import write_overlay
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.result_files import write_trajectories_csv
from track_before_detect.ros.conversions import points_to_array, seconds_from_time
from track_before_detect.ros.demo.child_process import ChildProcess
from track_before_detect.ros.demo.report import report
from track_before_detect.ros.domain import free_domain_id
from track_before_detect.ros.executables.ending import Ending
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.tracking.batcher import DEFAULT_LENGTH
from track_before_detect.tracking.joined import JoinedTrajectories
from track_before_detect.types import Trajectory

SCENARIO = 'eo_ir_drones'
# With this seed each target flies far enough to be seen in the picture.
SEED = 2
SLOWEST_HZ, FASTEST_HZ, AUTOMATIC_HZ = 10.0, 100.0, 25.0
QUEUE_BYTES = 2**30
# Playing goes at its own pace, so the time after which the last frames are searched is given in
# seconds here and not in intervals of the recording.
FLUSH_AFTER_S = 1.0
SILENCE_TIMEOUT_S = 60.0
DISCOVERY_TIMEOUT_S = 60.0
RESULT_TIMEOUT_S = 20.0


class DemoError(Exception):
    """The demo cannot go on; holds the exit code too."""

    def __init__(self, message: str, code: int = FAILED):
        super().__init__(message)
        self.code = code


@dataclass
class Heard:
    """What the demo has received over DDS.

    Attributes
    ----------
    batches : list of (float, array)
        Of each batch the stamp of its newest frame in seconds, and its points, see
        ``points_from_trajectories``.
    diagnostics : dict
        Last key-value pairs of the detector.
    last_diagnostics_s : float
        Monotonic time of these.
    searched_until_s : float
        Stamp of the newest frame of the batches searched so far.
    """

    batches: list[tuple[float, NDArray]] = field(default_factory=list)
    diagnostics: dict[str, str] = field(default_factory=dict)
    last_diagnostics_s: float = field(default_factory=time.monotonic)
    searched_until_s: float = -np.inf

    @property
    def n_trajectories(self) -> int:
        """Number of ids so far."""
        return len({int(identity) for _, points in self.batches for identity in points['id']})

    def count(self, key: str) -> int:
        """Return a counter of the diagnostics."""
        return int(self.diagnostics.get(key, '0'))

    @property
    def state(self) -> str:
        """State of the detector and its details."""
        if not self.diagnostics:
            return 'starting'
        return f'{self.diagnostics["state"]} {self.diagnostics["detail"]}'.strip()


class Listener(Node):
    """Collects what the two nodes publish."""

    def __init__(self, heard: Heard):
        super().__init__('demo')
        self._heard = heard
        self.create_subscription(PointCloud2, 'trajectories/points', self._take_points, 100)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)

    def _take_points(self, message: PointCloud2) -> None:
        newest_s = seconds_from_time(message.header.stamp)
        self._heard.batches.append((newest_s, points_to_array(message)))
        self._heard.searched_until_s = newest_s

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.rpartition('/')[2] == 'detector':
                self._heard.diagnostics = {pair.key: pair.value for pair in status.values}
                self._heard.last_diagnostics_s = time.monotonic()


@dataclass
class Listening:
    """What it takes to listen to the detector for as long as it is well."""

    executor: SingleThreadedExecutor
    heard: Heard
    detector: ChildProcess
    ending: Ending

    def go_on(self) -> None:
        """Receive for a moment and make sure that the detector is well."""
        self.executor.spin_once(timeout_sec=0.1)
        if self.ending.requested:
            raise KeyboardInterrupt
        code = self.detector.exit_code
        if code is not None:
            raise DemoError(_ended(self.detector), BAD_INPUT if code == BAD_INPUT else FAILED)
        log, heard = self.detector.log, self.heard
        if heard.diagnostics.get('state') == 'failed':
            raise DemoError(f'the detector failed: {heard.diagnostics["detail"]}', BAD_INPUT)
        if time.monotonic() - heard.last_diagnostics_s > SILENCE_TIMEOUT_S:
            raise DemoError(f'nothing heard from the detector for {SILENCE_TIMEOUT_S:.0f} s over '
                            f'DDS (log: {log})')


class StatusLine:
    """Says what is being waited for: in place on a terminal, else one line per change."""

    def __init__(self, stream: TextIO = sys.stderr):
        self._stream = stream
        self._in_place = stream.isatty()
        self._began_s = time.monotonic()
        self._what = ''

    def show(self, what: str, detail: str = '') -> None:
        """Show ``what`` with a detail that may change quickly."""
        if self._in_place:
            seconds = time.monotonic() - self._began_s
            line = f'{what}: {detail}' if detail else what
            self._stream.write(f'\r\033[K{line[:90]} ({seconds:.0f} s)')
        elif what != self._what:
            self._stream.write(f'{what}\n')
        self._what = what
        self._stream.flush()

    def clear(self) -> None:
        """Remove the line."""
        if self._in_place:
            self._stream.write('\r\033[K')
            self._stream.flush()


def main(ending: Ending, arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the demo and end the process."""
    status = StatusLine()
    try:
        options = _parser().parse_args(arguments)
        ending.hold()
        code = _run(options, status, ending)
    except DemoError as error:
        status.clear()
        code = fail('demo', error, error.code)
    except KeyboardInterrupt:
        status.clear()
        print('demo: interrupted', file=sys.stderr)
        # Ended as whoever watched it wished, like the nodes.
        code = 0
    except (TbdError, OSError) as error:
        status.clear()
        code = fail('demo', error)
    ending.leave(code)


def _parser() -> Parser:
    parser = Parser(
        prog='demo',
        description='Play a recording to the detector over DDS and show what it finds.',
        epilog='example:\n  demo pan.npz --set registration=translation '
        '--set max_speed_px_s=100 \\\n      --set background=temporal_median --set noise=robust\n'
        '\nexit codes: 0 found, or ended by Ctrl-C, 3 nothing found, 2 bad input or option, '
        '1 failed')
    parser.add_argument(
        'input', metavar='INPUT', nargs='?',
        help='.npz, folder of images, multi-page TIFF, FITS cube, video or rosbag2 (default: the '
        f'scenario {SCENARIO}, simulated on the spot)')
    add_set_argument(parser, 'set one option of the detector; may be repeated (tbd detect '
                     '--list-options names them)')
    parser.add_argument('--topic', metavar='NAME', help='topic of a bag')
    parser.add_argument('--rate', metavar='HZ', type=float,
                        help='frames played per second; stamps stay those of the recording '
                        f'(default: as recorded, {AUTOMATIC_HZ:g} where that is not from '
                        f'{SLOWEST_HZ:g} to {FASTEST_HZ:g})')
    add_output_argument(parser, 'overlay.png, trajectories.csv and the logs of the nodes')
    parser.add_argument('--executables', metavar='DIR',
                        help='folder with the executables detector and frame_publisher (default: '
                        "this Python's own modules)")
    return parser


def _run(arguments: Namespace, status: StatusLine, ending: Ending) -> int:
    options = _given_options(arguments.set)
    if arguments.rate is not None:
        checked_number('--rate', arguments.rate, above=0.0, maximum=10000.0, unit='Hz')
    output = Path(arguments.output)
    if arguments.input is not None and not Path(arguments.input).exists():
        # Said before the output folder is made.
        raise ParameterError(f'INPUT {arguments.input} does not exist')
    output.mkdir(parents=True, exist_ok=True)
    source = arguments.input or _simulated(output)
    with open_recording(source, arguments.topic) as recording:
        # What was found is told apart by the stamps of the frames.
        checked_stamps(recording.stamps, len(recording), f'stamps of {recording.name}')
        print(f'{recording.name}: {len(recording)} frames of {recording.shape[0]} x '
              f'{recording.shape[1]} px', flush=True)
        heard = _play(arguments, options, Path(source), recording, output, status, ending)
        trajectories = joined_batches(heard.batches, recording.stamps,
                                      DetectorOptions.from_mapping(options))
        truth = recording.truth
        middle = len(recording) // 2
        overlay, table = output / 'overlay.png', output / 'trajectories.csv'
        write_overlay(overlay, recording[middle], trajectories, truth,
                      f'{recording.name}, frame {middle}', middle)
        write_trajectories_csv(table, trajectories)
    print(report(trajectories, truth))
    _print_losses(heard, len(recording))
    print(f'written: {overlay}, {table}')
    return FOUND if trajectories else NOTHING_FOUND


def _given_options(texts: Sequence[str]) -> dict[str, Any]:
    """Return the options given on the command line, checked."""
    values = {key: parse_option(key, text) for key, text in assignments(texts).items()}
    checked = DetectorOptions.from_mapping(values)
    return {key: getattr(checked, key) for key in values if getattr(checked, key) is not None}


def _simulated(output: Path) -> str:
    """Make the recording of the demo and return its path."""
    path = output / f'{SCENARIO}.npz'
    made = simulate(SCENARIO, SEED)
    write_npz_recording(path, made.frames, made.stamps, made.truth)
    return str(path)


def _play(arguments: Namespace, options: dict[str, Any], source: Path, recording: Recording,
          output: Path, status: StatusLine, ending: Ending) -> Heard:
    """Run both nodes until every frame has been searched; return what they said."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    if 'ROS_DOMAIN_ID' not in os.environ:
        os.environ['ROS_DOMAIN_ID'] = str(free_domain_id())
    detector = ChildProcess(
        'detector', _command('detector', arguments.executables, {
            **_detector_parameters(recording), **options}), output / 'detector.log')
    publisher = ChildProcess(
        'frame_publisher', _command('frame_publisher', arguments.executables, {
            'input': str(source.resolve()), 'original_stamps': True,
            'rate_hz': _play_rate(arguments.rate, recording),
            **({} if arguments.topic is None else {'topic': arguments.topic})}),
        output / 'frame_publisher.log')
    heard = Heard()
    # A signal is not to shut rclpy down in the middle.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    with ExitStack() as stack:
        stack.callback(rclpy.try_shutdown)
        node = Listener(heard)
        stack.callback(node.destroy_node)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        stack.callback(executor.shutdown)
        listening = Listening(executor, heard, detector, ending)
        stack.enter_context(detector).start()
        _wait_until_ready(listening, status)
        stack.enter_context(publisher).start()
        # Both at once, before each is waited for.
        stack.callback(detector.interrupt)
        stack.callback(publisher.interrupt)
        _wait_until_searched(listening, publisher, recording, status)
        status.show('stopping the nodes')
        for child in (publisher, detector):
            if not child.stop():
                raise DemoError(_ended(child))
        status.clear()
    return heard


def _command(node: str, executables: str | None, parameters: dict[str, Any]) -> list[str]:
    """Return the command line of a node."""
    program = ([sys.executable, '-m', f'track_before_detect.ros.executables.{node}']
               if executables is None else [str(Path(executables).resolve() / node)])
    # JSON is YAML, which ROS reads, with its strings quoted.
    settings = [part for key, value in parameters.items()
                for part in ('-p', f'{key}:={json.dumps(value, ensure_ascii=False)}')]
    return [*program, '--ros-args', *settings]


def _detector_parameters(recording: Recording) -> dict[str, Any]:
    """Return the parameters that let the detector prepare itself and drop nothing."""
    height, width = recording.shape
    frame_bytes = height * width * recording.dtype.itemsize
    intervals = np.diff(recording.stamps)
    return {
        'reliable': True, 'frame_height': height, 'frame_width': width,
        'frame_rate_hz': 1.0 / float(np.median(intervals)) if len(intervals) else 1.0,
        'flush_after_s': FLUSH_AFTER_S,
        'queue_length': max(60, min(len(recording), QUEUE_BYTES // frame_bytes))}


def _play_rate(wanted: float | None, recording: Recording) -> float:
    """Return the frames played per second."""
    if wanted is not None:
        return wanted
    intervals = np.diff(recording.stamps)
    rate = 1.0 / float(np.median(intervals)) if len(intervals) else AUTOMATIC_HZ
    usable = recording.stamps_known and SLOWEST_HZ <= rate <= FASTEST_HZ
    return rate if usable else AUTOMATIC_HZ


def _wait_until_ready(listening: Listening, status: StatusLine) -> None:
    """Wait until the detector has compiled its loops and calibrated its threshold."""
    heard = listening.heard
    while heard.diagnostics.get('state') != 'ready':
        listening.go_on()
        state = heard.diagnostics.get('state', 'starting')
        status.show(f'detector: {state}', heard.diagnostics.get('detail', ''))


def _wait_until_searched(listening: Listening, publisher: ChildProcess, recording: Recording,
                         status: StatusLine) -> None:
    """Wait until the batch with the last frame has been searched."""
    heard, log = listening.heard, listening.detector.log
    last_s = float(recording.stamps[-1])
    tolerance_s = 1e-6 * max(1.0, abs(last_s) * 1e-6)
    n_frames = len(recording)
    last_change_s, counted = time.monotonic(), None
    while heard.searched_until_s < last_s - tolerance_s:
        listening.go_on()
        code = publisher.exit_code
        if code:
            raise DemoError(_ended(publisher), BAD_INPUT if code == BAD_INPUT else FAILED)
        received, batches = heard.count('frames_received'), heard.count('batches')
        what = 'playing' if code is None else 'searching the last frames'
        if code is None and not received:
            what = 'waiting for frame_publisher and detector to find each other'
        status.show(what, f'{received} of {n_frames} frames, {batches} batches, '
                          f'{heard.n_trajectories} trajectories')
        busy = (heard.diagnostics.get('searching') == 'true' or (code is None and received)
                or (received and heard.diagnostics['state'] != 'ready'))
        if busy or (received, batches, code) != counted:
            last_change_s, counted = time.monotonic(), (received, batches, code)
        quiet_s = time.monotonic() - last_change_s
        if quiet_s > (DISCOVERY_TIMEOUT_S if code is None else RESULT_TIMEOUT_S):
            if heard.count('failures'):
                raise DemoError(f'the detector failed: {heard.diagnostics["last_warning"]} (log: '
                                f'{log})', BAD_INPUT)
            if not heard.count('batches'):
                raise DemoError(f'no frame was searched for {quiet_s:.0f} s; the detector was: '
                                f'{heard.state} (log: {log})')
            # The last frame was lost on the way; what was found without it still counts.
            break
    # The counters in the last diagnostics may be older than the result.
    searched_s = time.monotonic()
    while heard.last_diagnostics_s < searched_s:
        listening.go_on()


def _ended(child: ChildProcess) -> str:
    """Return a sentence about a node that ended too early or badly."""
    lines = child.last_lines(1)
    if child.exit_code == BAD_INPUT and lines:
        return lines[0].partition('error: ')[2] or lines[0]
    said = f', its last words: {lines[0]}' if lines else ''
    return f'{child.name} ended with exit code {child.exit_code}{said} (log: {child.log})'


def _frame_numbers(stamps_s: NDArray[np.float64], recorded_s: NDArray[np.float64],
                   ) -> NDArray[np.int64]:
    """Return the number of the frame whose stamp is nearest, for each stamp."""
    after = np.clip(np.searchsorted(recorded_s, stamps_s), 1, max(1, len(recorded_s) - 1))
    before = after - 1
    if len(recorded_s) == 1:
        return np.zeros(len(stamps_s), np.int64)
    nearer = stamps_s - recorded_s[before] < recorded_s[after] - stamps_s
    return np.where(nearer, before, after)


def joined_batches(batches: Iterable[tuple[float, NDArray]], recorded_s: NDArray[np.float64],
                   options: DetectorOptions) -> list[Trajectory]:
    """Return what was found in a recording, one trajectory per id, as ``tbd detect`` does.

    Parameters
    ----------
    batches : iterable of (float, array)
        As in :class:`Heard`.
    recorded_s : array, shape (T,)
        Stamps of the recording.
    options : DetectorOptions
        Of the node.
    """
    joined = JoinedTrajectories(recorded_s, options.psf_sigma_px)
    length = options.batch_length or DEFAULT_LENGTH
    for newest_s, points in batches:
        [newest] = _frame_numbers(np.array([newest_s]), recorded_s)
        frames = _frame_numbers(points['t'], recorded_s)
        found = []
        for identity in np.unique(points['id']):
            own = points[points['id'] == identity]
            found.append(Trajectory(
                id=int(identity), positions=np.column_stack([own['x'], own['y']]).astype(float),
                amplitudes=own['amplitude'].astype(float),
                velocity=np.column_stack([own['vx'], own['vy']]).astype(float),
                stamps=own['t'], frame_indices=frames[points['id'] == identity],
                statistic=float(own['statistic'][0]), snr=float(own['snr'][0]),
                covariance=np.column_stack([own[name] for name in (
                    'var_x', 'cov_xy', 'cov_xy', 'var_y')]).reshape(-1, 2, 2).astype(float)))
        joined.add(np.arange(max(0, newest - length + 1), newest + 1), found)
    return joined.trajectories()


def _print_losses(heard: Heard, n_frames: int) -> None:
    """Say so when the detector did not search every frame."""
    received = heard.count('frames_received')
    counts = {'lost on the way': n_frames - received, 'dropped': heard.count('frames_dropped'),
              'refused': heard.count('frames_refused')}
    lost = ', '.join(f'{count} {what}' for what, count in counts.items() if count > 0)
    if lost:
        print(f'note: of {n_frames} frames {lost}')
