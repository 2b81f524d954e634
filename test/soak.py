"""Run the detector for a long time over DDS, with faults if wanted, and say how it fared.

``python test/soak.py --minutes 20 --size 128 128 --rate 30 --faults restarts malformed jumps``

``--minutes 2 --rate 10 --faults malformed --malformed 9`` sends more than 10,000 messages that
cannot be frames among 1,200 that are.

Not collected by pytest. Ends with 1 when a limit is not kept: frames that were delivered and not
searched, memory that grows, results that come later than the next batch begins, or a target that
is not followed.
"""

import argparse
from collections import Counter
from contextlib import ExitStack
import math
import os
from pathlib import Path
import signal
import sys
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Float32MultiArray, Header, MultiArrayDimension

from track_before_detect.recordings.encodings import ENCODINGS
from track_before_detect.ros import conversions
from track_before_detect.ros.demo.child_process import ChildProcess
from track_before_detect.ros.domain import free_domain_id

PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds_profile.xml'
FAULTS = ('restarts', 'malformed', 'jumps')
BATCH, HOP = 20, 10
MOST_GROWTH, NEAR_PX, SPEED_PX_S = 0.02, 2.0, 5.0
# Seconds before memory is compared, and between two faults of a kind.
WARM_UP_S, FAULT_PERIOD_S = 20.0, 17.0
# Memory is a median over so many seconds, or this share of a shorter life: from one moment to the
# next it differs by the frames of a batch, which may be held or not.
MEMORY_S, MEMORY_SHARE = 60.0, 0.1
# Of the batches; with faults the first ones after each may miss the target.
LEAST_FOLLOWED = {False: 0.98, True: 0.8}
# Late results whose time is told.
MOST_TOLD = 60
QOS = QoSProfile(depth=20, reliability=QoSReliabilityPolicy.RELIABLE)
# Of messages that are wrong in one way or another, beside some that only look so.
LARGEST = 2**32 - 1
STRANGE = ['', 'nv12', '64FC3', 'mono8 ', 'ü', 'x' * 300]
VALUES = [0.0, 1.0, -1e38, 1e38, np.nan, np.inf, -np.inf, 1e-45]
LABELS = ['', 'rows', 'stamp=', 'stamp=1', 'stamp=9999999999.000000000', 'stamp=-1.000000000',
          'stamp=100.000000001 frame_id=', 'stamp=nan', 'stamp=5.5 frame_id=a b', 'ü' * 300]


def truth(time_s, shape):
    """Return x and y of the target in pixels: on a circle, as fast in frames of any size."""
    radius = 0.2 * min(shape)
    angle = SPEED_PX_S * time_s / radius
    return shape[1] / 2 + radius * math.sin(angle), shape[0] / 2 + radius * math.cos(angle)


def publish(arguments):
    """Publish noise with one target; print how many frames so far, once a second."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('soak_publisher')
    publisher = node.create_publisher(Image, 'image', QOS)
    rng = np.random.default_rng(arguments.seed)
    height, width = shape = tuple(arguments.size)
    pool = rng.standard_normal((32, height, width)).astype(np.float32)
    rows, columns = np.arange(height)[:, None], np.arange(width)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    began_s = said_s = jumped_s = time.monotonic()
    offset_s, n_sent = 0.0, Counter()
    while True:
        due_s = began_s + n_sent['good'] / arguments.rate
        time.sleep(max(0.0, due_s - time.monotonic()))
        now_s = time.time()
        if 'jumps' in arguments.faults and time.monotonic() - jumped_s > FAULT_PERIOD_S:
            # Back and forth by more than a batch.
            jumped_s, offset_s = time.monotonic(), 0.0 if offset_s else -1000.0
        if 'malformed' in arguments.faults:
            for _ in range(rng.poisson(arguments.malformed)):
                publisher.publish(malformed(rng, shape))
                n_sent['malformed'] += 1
        x, y = truth(now_s, shape)
        frame = np.roll(pool[rng.integers(len(pool))], rng.integers(height * width))
        frame = frame + 6.0 * np.exp(
            -0.5 * ((columns - x) ** 2 + (rows - y) ** 2)) / math.sqrt(math.pi)
        # The time it was made comes back with the results as the frame's name.
        publisher.publish(conversions.image_from_frame(frame.astype(np.float32), Header(
            stamp=conversions.time_from_seconds(now_s + offset_s), frame_id=f'{now_s:.6f}')))
        n_sent['good'] += 1
        if time.monotonic() - said_s > 1.0:
            said_s = time.monotonic()
            print(n_sent['good'], n_sent['malformed'], flush=True)


def wild(rng, shape):
    """Return a message of frames, of ``shape`` at times, that may be anything."""
    return (_image, _array)[rng.integers(2)](rng, shape)


def _image(rng, shape):
    encoding = str(rng.choice([*ENCODINGS, *STRANGE]))
    height, width = shape if rng.random() < 0.3 else _sizes(rng, 2)
    message = Image(
        header=_header(rng), height=height, width=width, encoding=encoding,
        step=int(rng.choice([width, 4 * width, 8 * width, *_sizes(rng, 2)]) & LARGEST),
        is_bigendian=int(rng.integers(256)))
    # Of the right size, or not, and of values that no camera has.
    n_bytes = int(rng.choice([min(message.step * height, 10**5), rng.integers(1000)]))
    message.data = rng.choice([rng.bytes(n_bytes), np.full(
        n_bytes // 4 + 1, rng.choice(VALUES), np.float32).tobytes()[:n_bytes]])
    return message


def _array(rng, shape):
    message = Float32MultiArray()
    sizes = list(shape) if rng.random() < 0.3 else _sizes(rng, rng.integers(5))
    message.layout.data_offset = int(rng.choice([0, 0, 3, LARGEST]))
    message.layout.dim = [MultiArrayDimension(
        label=str(rng.choice(LABELS)), size=size, stride=int(rng.choice([0, size, *shape])))
        for size in sizes]
    n_items = int(rng.choice([np.prod(shape), rng.integers(2000)]))
    message.data = np.full(n_items, rng.choice(VALUES), np.float32).tolist()
    return message


def malformed(rng, shape):
    """Return an image that cannot be a frame."""
    message = _image(rng, shape)
    flaw = rng.integers(5)
    if flaw == 0:
        message.encoding = str(rng.choice(STRANGE))
    elif flaw == 1:
        message.step = 0
    elif flaw == 2:
        message.data = b''
    elif flaw == 3:
        message.height, message.width = [0, message.width][::rng.choice([1, -1])]
    else:
        message.header.stamp.nanosec = int(rng.integers(10**9, LARGEST))
    return message


def _sizes(rng, count):
    return [int(size) for size in rng.choice([0, 1, 3, 17, 40, 200, 65535, LARGEST], count)]


def _header(rng):
    header = Header(frame_id=str(rng.choice(['camera', *STRANGE])))
    header.stamp.sec = int(rng.choice([0, 100, 101, -1, -2**31, 2**31 - 1]))
    header.stamp.nanosec = int(rng.choice([0, 1, 10**9 - 1, 10**9, LARGEST]))
    return header


class Soak:
    """What is heard of the detector, and what became of it."""

    def __init__(self, arguments, folder):
        self.arguments = arguments
        self.shape = tuple(arguments.size)
        self.latencies_s, self.memory = [], []
        # When results came, seconds after the begin.
        self.heard_s = []
        self.lives = [{}]
        self.n_batches = self.n_followed = self.n_others = 0
        self._stack = ExitStack()
        self._folder = folder
        self._began_s = time.monotonic()
        self.logs = []
        self.cpu_s = 0.0
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('soak')
        self.node.create_subscription(PointCloud2, 'trajectories/points', self._hear_points, 50)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear_state, 50)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.detector = self._start('detector', [
            '-m', 'track_before_detect.ros.executables.detector', '--ros-args', '-p',
            'reliable:=true', '-p', f'batch_length:={BATCH}', '-p', f'hop:={HOP}', '-p',
            f'frame_height:={self.shape[0]}', '-p', f'frame_width:={self.shape[1]}', '-p',
            f'frame_rate_hz:={arguments.rate}', '-p', 'preset:=none'])
        self.publisher = self._start('publisher', [__file__, '--publish', *sys.argv[1:]])

    def _start(self, name, command):
        log = self._folder / f'{name}{len(self.logs)}.log'
        self.logs.append(log)
        child = ChildProcess(name, [sys.executable, *command], log)
        child.command = command
        self._stack.enter_context(child).start()
        return child

    def restart(self, name):
        """Kill a process and start it again."""
        child = getattr(self, name)
        os.kill(child.pid, signal.SIGKILL)
        child.stop()
        if name == 'detector':
            self.lives.append({})
            self.memory.clear()
        setattr(self, name, self._start(name, child.command))

    def _hear_points(self, message):
        made_s = float(message.header.frame_id)
        self.latencies_s.append(time.time() - made_s)
        self.heard_s.append(time.monotonic() - self._began_s)
        points = conversions.points_to_array(message)
        newest = points[points['t'] >= points['t'].max(initial=0.0) - 1e-6]
        x, y = truth(made_s, self.shape)
        near = np.hypot(newest['x'] - x, newest['y'] - y) < NEAR_PX
        self.n_batches += 1
        self.n_followed += bool(near.any())
        self.n_others += len(set(newest['id'][~near]))

    def _hear_state(self, message):
        for status in message.status:
            if status.name == 'detector':
                self.lives[-1] = {pair.key: pair.value for pair in status.values}

    def run(self):
        """Listen until the time is over, with a fault now and then."""
        end_s = self._began_s + 60.0 * self.arguments.minutes
        looked_s = fault_s = time.monotonic()
        victims = ['detector', 'publisher']
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.1)
            for child in (self.detector, self.publisher):
                assert child.exit_code is None, f'{child.name} ended: {child.last_lines(3)}'
            if time.monotonic() - looked_s > 0.5:
                looked_s = time.monotonic()
                pages = int(Path(f'/proc/{self.detector.pid}/statm').read_text().split()[1])
                self.memory.append((looked_s, pages * os.sysconf('SC_PAGE_SIZE')))
            restarts = 'restarts' in self.arguments.faults
            if restarts and time.monotonic() - fault_s > FAULT_PERIOD_S:
                fault_s = time.monotonic()
                self.restart(victims[0])
                victims.reverse()

    def close(self):
        """End the publisher, wait for the last results, end the detector."""
        self.publisher.stop()
        until_s = time.monotonic() + 5.0
        while time.monotonic() < until_s:
            self.executor.spin_once(timeout_sec=0.1)
        words = Path(f'/proc/{self.detector.pid}/stat').read_text().rsplit(')')[-1].split()
        self.cpu_s = (int(words[11]) + int(words[12])) / os.sysconf('SC_CLK_TCK')
        stopped = self.detector.stop()
        self._stack.close()
        self.node.destroy_node()
        rclpy.try_shutdown()
        assert stopped, f'the detector did not end well: {self.detector.last_lines(3)}'

    def growth(self):
        """Return memory after warm-up and at the end, in bytes; None when it was too short."""
        began_s = self.memory[0][0] if self.memory else 0.0
        times, sizes = (np.array(self.memory) if self.memory else np.empty((0, 2))).T
        end_s = times.max(initial=0.0)
        median_s = min(MEMORY_S, MEMORY_SHARE * (end_s - began_s))
        first = (times > began_s + WARM_UP_S) & (times < began_s + WARM_UP_S + median_s)
        last = times > end_s - median_s
        if not first.any() or times[last].min() < times[first].max():
            return None
        return np.median(sizes[first]), np.median(sizes[last])

    def report(self):
        """Print how it went; return the sentences about limits that were not kept."""
        failures = []
        counts = Counter()
        for life in self.lives:
            counts.update({key: int(value) for key, value in life.items()
                           if key.startswith(('frames_', 'messages_', 'window_'))
                           and value.isdigit()})
        sent = [0, 0]
        for log in self.logs:
            if log.name.startswith('publisher') and (words := log.read_text().split()[-2:]):
                sent = [before + int(word) for before, word in zip(sent, words)]
        faulty = bool(self.arguments.faults)
        print(f'sent: {sent[0]} frames and {sent[1]} malformed messages, to the last full second')
        for key, value in sorted(counts.items()):
            print(f'{key}: {value}')
        accounted = sum(counts[f'frames_{what}'] for what in ('used', 'refused', 'waiting'))
        if counts['frames_received'] > accounted + counts['frames_dropped']:
            failures.append('frames that were received are not accounted for')
        if counts['frames_dropped']:
            failures.append(f'{counts["frames_dropped"]} frames were dropped')
        if counts['frames_refused'] > sent[1] * 1.1 + 30 * len(self.lives) * faulty:
            failures.append(f'{counts["frames_refused"]} messages were refused')
        share = self.n_followed / max(1, self.n_batches)
        print(f'batches: {self.n_batches}, target followed in {share:.1%}, '
              f'{self.n_others} other trajectories')
        if share < LEAST_FOLLOWED[faulty]:
            failures.append(f'the target was followed in {share:.1%} of the batches only')
        latencies_s = np.sort(self.latencies_s)
        if len(latencies_s):
            middle, late = np.percentile(latencies_s, (50, 99))
            hop_s = HOP / self.arguments.rate
            when = [f'{heard_s:.0f}' for heard_s, latency_s in zip(
                self.heard_s, self.latencies_s) if latency_s > hop_s]
            print(f'latency: median {1e3 * middle:.0f} ms, 99 % within {1e3 * late:.0f} ms '
                  f'(a hop is {1e3 * hop_s:.0f} ms), {len(when)} later than a hop, '
                  f'heard after {", ".join(when[:MOST_TOLD]) or "none"} s')
            if late > hop_s:
                failures.append(f'latency: 99 % within {1e3 * late:.0f} ms, not a hop')
        growth = self.growth()
        if growth is None:
            print('memory: the detector did not run for long enough to tell')
        else:
            before, after = growth
            print(f'memory: {before / 2**20:.1f} MB after warm-up, {after / 2**20:.1f} MB at the '
                  f'end ({after / before - 1.0:+.1%})')
            if after > before * (1.0 + MOST_GROWTH):
                failures.append(f'memory grew by {after / before - 1.0:.1%}')
        print(f'processor: {self.cpu_s:.1f} s in the last life of the detector')
        for failure in failures:
            print(f'FAILED: {failure}')
        return failures


def main():
    """Run the soak and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--minutes', type=float, default=1.0)
    parser.add_argument('--size', type=int, nargs=2, default=(128, 128),
                        metavar=('HEIGHT', 'WIDTH'))
    parser.add_argument('--rate', type=float, default=30.0, help='frames per second')
    parser.add_argument('--faults', nargs='*', choices=FAULTS, default=[])
    parser.add_argument('--malformed', type=float, default=0.2, metavar='N',
                        help='malformed messages for each good frame, with that fault')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--publish', action='store_true', help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.publish:
        publish(arguments)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(free_domain_id()))
    # As the launch files set them: a frame of 1 MB or more that does not fit through shared memory
    # comes in pieces over the loopback, and waits for seconds where one is lost.
    for name, value in (('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE)),
                        ('MALLOC_MMAP_THRESHOLD_', '1073741824'),
                        ('MALLOC_TRIM_THRESHOLD_', '1073741824')):
        os.environ.setdefault(name, value)
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(arguments, Path(folder))
        try:
            soak.run()
        finally:
            soak.close()
        return 1 if soak.report() else 0


if __name__ == '__main__':
    sys.exit(main())
