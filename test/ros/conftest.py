"""Nodes as processes that talk over DDS, on a domain of their own."""

import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from nodes.copies import can_be_copied, Copy, EXECUTABLES
import track_before_detect

TIMEOUT_S = 60.0
# Seconds after which a node that may not have discovered who asks is asked again.
ASK_AGAIN_S = 0.3

# A shell that starts the tests in the background has them ignore interrupts, and processes started
# from here would inherit that; what a handler is set for is back to normal in a new process.
signal.signal(signal.SIGINT, signal.default_int_handler)

try:
    with warnings.catch_warnings():
        # The message packages import these when a message is first sent; what they do is theirs.
        warnings.simplefilter('ignore')
        import lark  # noqa: F401
        from rcl_interfaces.srv import GetParameterTypes
        import rclpy
except ImportError:
    rclpy = None


class NodeProcess:
    """A node in a process of its own, and what it prints."""

    def __init__(self, name, *ros_args):
        arguments = ['--ros-args', *ros_args] if ros_args else []
        if can_be_copied():
            self.process = Copy(name, arguments)
        else:
            source = str(Path(track_before_detect.__file__).parents[1])
            path = os.pathsep.join(filter(None, [source, os.environ.get('PYTHONPATH')]))
            self.process = subprocess.Popen(
                [sys.executable, '-m', f'{EXECUTABLES}.{name}', *arguments],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                env={**os.environ, 'PYTHONPATH': path, 'PYTHONUNBUFFERED': '1'})
        self._lines = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            self._lines.append(line)

    @property
    def output(self):
        return ''.join(self._lines)

    def wait_for_line(self, pattern, timeout_s=TIMEOUT_S):
        """Return the first match; fail when the process ends or the time is over."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            # Asked before the output is searched, so that a last line is not missed.
            ended = self.process.poll() is not None and not self._reader.is_alive()
            match = re.search(pattern, self.output)
            if match:
                return match
            assert not ended, f'ended without {pattern!r}:\n{self.output}'
            time.sleep(0.02)
        raise AssertionError(f'no {pattern!r} within {timeout_s} s:\n{self.output}')

    def interrupt(self, number=signal.SIGINT):
        """Send a signal; return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self, timeout_s=TIMEOUT_S):
        """Return the exit code."""
        code = self.process.wait(timeout_s)
        self._reader.join(timeout_s)
        return code

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join(TIMEOUT_S)
        self.process.stdout.close()
        # Shown beside a test that failed.
        print(self.output)


@pytest.fixture(scope='session')
def ros_domain():
    """Take a domain of this test run's own, also for the processes it starts."""
    from track_before_detect.ros.domain import free_domain_id
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_DOMAIN_ID', str(free_domain_id()))
        patch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
        yield os.environ['ROS_DOMAIN_ID']


@pytest.fixture
def launch(ros_domain):
    """Start nodes, and end them with the test."""
    processes = []

    def start(name, *ros_args):
        processes.append(NodeProcess(name, *ros_args))
        return processes[-1]

    yield start
    for process in processes:
        process.close()


class Station:
    """The test's own end of the topics."""

    def __init__(self, context, name='test_station'):
        from rclpy.executors import SingleThreadedExecutor
        self.node = rclpy.create_node(name, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self.received = {}
        self.clients = {}

    def listen(self, kind, topic, qos=50):
        """Collect the messages of a topic in ``received[topic]``."""
        messages = self.received.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def wait_until(self, condition, what, timeout_s=TIMEOUT_S):
        """Spin until a condition holds; return its value."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            value = condition()
            if value:
                return value
            self._executor.spin_once(timeout_sec=0.05)
        received = {topic: len(messages) for topic, messages in self.received.items()}
        raise AssertionError(f'waited {timeout_s} s in vain for: {what}; received: {received}; '
                             f'newest diagnostics: {self.diagnostics()}')

    def spin_for(self, seconds):
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=min(0.05, seconds))

    def publisher(self, kind, topic, qos):
        """Return a publisher that somebody listens to, when all that is listened to is there.

        What answers the first message could be missed otherwise.
        """
        publisher = self.node.create_publisher(kind, topic, qos)
        self.wait_until(publisher.get_subscription_count, f'a subscriber of {topic}')
        self.wait_until(lambda: all(map(self.node.count_publishers, self.received)),
                        f'publishers of {list(self.received)}')
        return publisher

    def diagnostics(self, name='detector'):
        """Return the newest diagnostics of a node as a dictionary, empty before any."""
        for message in reversed(self.received.get('/diagnostics', [])):
            for status in message.status:
                if status.name == name:
                    values = {value.key: value.value for value in status.values}
                    return {**values, 'level': status.level, 'message': status.message}
        return {}

    def wait_for_diagnostics(self, name='detector', **expected):
        """Wait until the newest diagnostics of a node hold these values; return them."""
        def holds():
            found = self.diagnostics(name)
            return found if found and all(
                found[key] == str(value) for key, value in expected.items()) else None
        return self.wait_until(holds, f'diagnostics of {name} with {expected}')

    def call(self, kind, service, request):
        """Call a service; return the response."""
        self._meet(service.rpartition('/')[0])
        is_new = service not in self.clients
        client = self._client(kind, service)
        if is_new:
            # The answer is lost where the server has not yet discovered who asks.
            self.spin_for(0.5)
        future = client.call_async(request)
        return self.wait_until(lambda: future.done() and future.result(), f'answer of {service}')

    def _client(self, kind, service):
        client = self.clients.get(service)
        if client is None:
            client = self.clients[service] = self.node.create_client(kind, service)
            self.wait_until(client.service_is_ready, f'service {service}')
        return client

    def _meet(self, node):
        service = f'{node}/get_parameter_types'
        self.meet(self._client(GetParameterTypes, service), GetParameterTypes.Request())

    def meet(self, client, request):
        """Ask until there is an answer: what a node says before it has discovered us is lost."""
        asked = []

        def is_answered():
            if not asked or time.monotonic() - asked[-1][0] > ASK_AGAIN_S:
                asked.append((time.monotonic(), client.call_async(request)))
            return any(future.done() for _, future in asked)

        self.wait_until(is_answered, f'any answer of {client.srv_name}')

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def station(ros_domain):
    context = rclpy.Context()
    context.init(domain_id=int(ros_domain))
    station = Station(context)
    yield station
    station.close()
    context.try_shutdown()


def make_moving_target(n_frames, shape=(32, 40), amplitude=12.0, seed=0):
    """Return noise with one bright target, (T, H, W) float32, and its positions (T, 2)."""
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((n_frames, *shape)).astype(np.float32)
    rows, columns = np.mgrid[:shape[0], :shape[1]]
    k = np.arange(n_frames)
    # Back and forth within the frame, at most 0.6 px per frame.
    positions = np.column_stack([
        shape[1] / 2 + 10.0 * np.sin(0.05 * k), shape[0] / 2 + 6.0 * np.cos(0.05 * k)])
    for image, (x, y) in zip(frames, positions):
        stamp = np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2))
        image += amplitude * stamp / np.linalg.norm(stamp)
    return frames, positions


@pytest.fixture(scope='session')
def moving_target():
    """Return the function that makes a recording of one bright target."""
    return make_moving_target
