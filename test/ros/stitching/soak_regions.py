"""Let two detectors share a stream by regions for a long time, and count what the stitcher tells.

``python test/ros/stitching/soak_regions.py --minutes 20``

The second detector may run in a network namespace of its own, as on another host. As root:

    for n in a b; do ip netns add $n; ip -n $n link set lo up; done
    ip link add va netns a type veth peer name vb netns b
    ip -n a address add 10.99.0.1/24 dev va; ip -n b address add 10.99.0.2/24 dev vb
    for n in a b; do ip -n $n link set v$n up; ip -n $n route add default dev v$n; done
    export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET
    ip netns exec a python test/ros/stitching/soak_regions.py --minutes 20 --second-in b

Not collected by pytest. Ends with 1 when a target was told twice in a batch, got another id, or
was not found in all but a few of the batches.
"""

import argparse
from contextlib import ExitStack
import math
import os
from pathlib import Path
import sys
import tempfile
import time

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from track_before_detect.ros import conversions
from track_before_detect.ros.demo.child_process import ChildProcess
from track_before_detect.ros.domain import free_domain_id

SHAPE, RATE_HZ, BATCH, HOP, NEAR_PX = (80, 140), 10.0, 20, 10, 2.0
# Of the batches, of each target.
LEAST_FOUND = 0.98
REGIONS = {'first': '[0, 0, 86, 80]', 'second': '[54, 0, 86, 80]'}
# Centre, half axes and period of the ellipse of each target: across the seam, along it, and in
# either region alone.
ELLIPSES = [((70.0, 40.0), (45.0, 4.0), 80.0), ((70.0, 22.0), (3.0, 9.0), 60.0),
            ((24.0, 62.0), (10.0, 8.0), 60.0), ((112.0, 62.0), (12.0, 8.0), 60.0)]
# The targets are at other phases, so that no two meet.
PHASES = [0.0, 2.0, 1.0, 4.0]


def truth(time_s):
    """Return x and y of each target in pixels at times (T,), as (N, T, 2)."""
    return np.array([np.stack([
        x + a * np.sin(2.0 * np.pi * time_s / period + phase),
        y + b * np.cos(2.0 * np.pi * time_s / period + phase)], axis=-1)
        for ((x, y), (a, b), period), phase in zip(ELLIPSES, PHASES, strict=True)])


class RegionsSoak:
    """What the stitcher told, and how often a target was in it twice or under another id."""

    def __init__(self, arguments, folder):
        self.minutes = arguments.minutes
        self.n_batches = self.n_twice = self.n_changes = self.n_others = 0
        self.n_found = np.zeros(len(ELLIPSES), int)
        self.crossings = self.n_sent = 0
        self._ids = [None] * len(ELLIPSES)
        self._stack = ExitStack()
        self._folder = folder
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('soak_regions')
        self.node.create_subscription(PointCloud2, 'trajectories/points', self._hear, 50)
        self.publisher = self.node.create_publisher(Image, 'image', QoSProfile(
            depth=20, reliability=QoSReliabilityPolicy.RELIABLE))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        prefix = ['ip', 'netns', 'exec', arguments.second_in] if arguments.second_in else []
        self.children = [self._start('stitcher', [], '-p', 'inputs:=[first, second]')]
        for name, region in REGIONS.items():
            told = {'region': region, 'preset': 'none', 'reliable': 'true', 'batch_length': BATCH,
                    'hop': HOP, 'frame_rate_hz': RATE_HZ, 'queue_length': 50}
            self.children.append(self._start(
                'detector', prefix if name == 'second' else [], '-r', f'__ns:=/{name}', '-r',
                'image:=/image', *(word for key, value in told.items()
                                   for word in ('-p', f'{key}:={value}'))))

    def _start(self, executable, prefix, *arguments):
        command = [*prefix, sys.executable, '-m',
                   f'track_before_detect.ros.executables.{executable}', '--ros-args', *arguments]
        log = self._folder / f'{len(os.listdir(self._folder))}.log'
        child = ChildProcess(executable, command, log)
        self._stack.enter_context(child).start()
        return child

    def _hear(self, message):
        points = conversions.points_to_array(message)
        self.n_batches += 1
        right = np.zeros(len(points), bool)
        for number, path in enumerate(truth(points['t'].astype(float))):
            near = np.hypot(points['x'] - path[:, 0], points['y'] - path[:, 1]) < NEAR_PX
            # What is near a target for most of the batch is a sighting of it.
            ids = [one for one in set(points['id'][near])
                   if near[points['id'] == one].sum() > 0.5 * BATCH]
            right |= np.isin(points['id'], ids)
            self.n_found[number] += bool(ids)
            self.n_twice += len(ids) > 1
            if ids:
                self.n_changes += self._ids[number] not in (None, *ids)
                self._ids[number] = ids[0]
        self.n_others += len(set(points['id'][~right]))

    def run(self):
        """Publish until the time is over, and listen."""
        began_s = time.monotonic()
        while self.publisher.get_subscription_count() < len(REGIONS):
            self.executor.spin_once(timeout_sec=0.1)
            assert time.monotonic() - began_s < 120.0, 'the detectors do not hear the frames'
        rng = np.random.default_rng(0)
        rows, columns = np.arange(SHAPE[0])[:, None], np.arange(SHAPE[1])
        began_s = time.monotonic()
        end_s = began_s + 60.0 * self.minutes
        while time.monotonic() < end_s:
            # The clock of the frames is the same as that of the targets.
            stamp_s = time.time()
            frame = rng.standard_normal(SHAPE)
            for [[x, y]] in truth(np.array([stamp_s])):
                frame += 8.0 * np.exp(
                    -0.5 * ((columns - x) ** 2 + (rows - y) ** 2)) / math.sqrt(math.pi)
            self.publisher.publish(conversions.image_from_frame(
                frame.astype(np.float32),
                Header(stamp=conversions.time_from_seconds(stamp_s), frame_id='camera')))
            self.n_sent += 1
            due_s = began_s + self.n_sent / RATE_HZ
            while (left_s := due_s - time.monotonic()) > 0:
                self.executor.spin_once(timeout_sec=left_s)
            for child in self.children:
                assert child.exit_code is None, f'{child.name} ended: {child.last_lines(3)}'
        self.crossings = int(2 * 60.0 * self.minutes / ELLIPSES[0][2])

    def close(self):
        """End all nodes."""
        ended = [child.stop() for child in self.children]
        self._stack.close()
        self.node.destroy_node()
        rclpy.try_shutdown()
        assert all(ended), [child.last_lines(3) for child in self.children]

    def report(self):
        """Print how it went; return the sentences about what should not have been."""
        print(f'sent: {self.n_sent} frames; merged batches: {self.n_batches}; the first target '
              f'crossed the seam {self.crossings} times')
        print(f'targets found in {", ".join(str(n) for n in self.n_found)} of the batches; '
              f'{self.n_others} other trajectories')
        print(f'a target told twice in a batch: {self.n_twice}; another id: {self.n_changes}')
        failures = [f'a target {what} {count} times' for what, count in (
            ('was told twice', self.n_twice), ('got another id', self.n_changes)) if count]
        expected = (self.n_sent - BATCH) // HOP
        if min(self.n_found) < LEAST_FOUND * expected:
            failures.append(f'a target was found in {min(self.n_found)} of {expected} batches')
        for failure in failures:
            print(f'FAILED: {failure}')
        return failures


def main():
    """Run the soak and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=1.0)
    parser.add_argument('--second-in', metavar='NAMESPACE',
                        help='network namespace of the second detector')
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(free_domain_id()))
    with tempfile.TemporaryDirectory() as folder:
        soak = RegionsSoak(arguments, Path(folder))
        try:
            soak.run()
        finally:
            soak.close()
        return 1 if soak.report() else 0


if __name__ == '__main__':
    sys.exit(main())
