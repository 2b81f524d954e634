"""Frames of several sensors put in the order of their stamps, as far as waiting is worth it.

No ROS types in here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import heapq
import math

from track_before_detect.errors import DataError
from track_before_detect.ros.frame_queue import StreamFrame
from track_before_detect.tracking.sensors import padded

# Without a frame that could be used for so long, stamps have jumped rather than come late.
STUCK_S = 1.0
# Intervals of a sensor after which it is silent, and the shortest time.
SILENT_INTERVALS, SILENT_S = 5, 2.0


@dataclass
class SensorCount:
    """What became of the frames of one sensor.

    Attributes
    ----------
    received : int
        Messages that came, also those that are no frames.
    late : int
        Of these, those left out because later ones had gone on.
    newest_s : float
        Monotonic clock when the newest came; NaN before the first.
    interval_s : float
        Between the last two.
    """

    received: int = 0
    late: int = 0
    newest_s: float = math.nan
    interval_s: float = 0.0

    def arrive(self, now_s: float) -> None:
        """Count a message that came at a time of the monotonic clock."""
        if self.received:
            self.interval_s = now_s - self.newest_s
        self.received += 1
        self.newest_s = now_s

    def silent_s(self, now_s: float) -> float:
        """Return for how long nothing has come, if too long, else 0; infinite before the first."""
        if math.isnan(self.newest_s):
            return math.inf
        silent = now_s - self.newest_s
        return silent if silent > max(SILENT_S, SILENT_INTERVALS * self.interval_s) else 0.0


class SensorStream:
    """Makes one stream of the frames of several sensors, padded to the size of the largest.

    A frame is held until no earlier one can come from another sensor, or for a bounded time.

    A sensor that others have waited for in vain is not waited for until it sends again. Stamps
    that jump, those of a recording that is played in a loop, go on as they come.

    Parameters
    ----------
    names : sequence of str
        Of the sensors, for sentences.
    shapes : sequence of (int, int)
        (H, W) of the frames of each.
    wait_s : float
        Longest time that a frame waits for those of other sensors.

    Attributes
    ----------
    counts : list of SensorCount
        One for each sensor; whoever receives the messages tells them of each that arrives.
    """

    def __init__(self, names: Sequence[str], shapes: Sequence[tuple[int, int]],
                 wait_s: float) -> None:
        self.counts = [SensorCount() for _ in names]
        self._names, self._shapes = names, shapes
        self._wait_s = wait_s
        self._held: list[tuple[float, int, int, StreamFrame]] = []
        self._newest = [-math.inf] * len(names)
        self._waited_for = set(range(len(names)))
        self._passed, self._passed_at_s = -math.inf, -math.inf
        self._n_passed = 0

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the frames that go on."""
        heights, widths = zip(*self._shapes, strict=True)
        return max(heights), max(widths)

    @property
    def deadline_s(self) -> float | None:
        """Monotonic clock until which the next frame waits, None where none does."""
        return self._held[0][-1].arrival_s + self._wait_s if self._held else None

    def add(self, frame: StreamFrame) -> list[StreamFrame]:
        """Take a frame in the order of arrival; return those that go on, in order.

        Raises
        ------
        DataError
            The frame has another size, comes too late, or a second time.
        """
        number, stamp, name = frame.sensor, frame.stamp_s, self._names[frame.sensor]
        if frame.pixels.shape != self._shapes[number]:
            raise DataError(f'sensor {name}: expected frames of {_size(self._shapes[number])}, '
                            f'found {_size(frame.pixels.shape)}')
        self._waited_for.add(number)
        if stamp == self._newest[number]:
            raise DataError(f'sensor {name}: expected a stamp after {stamp:.6f} s, found the same '
                            'one again (is header.stamp filled in?)')
        went_on: list[StreamFrame] = []
        stuck = stamp < self._passed and frame.arrival_s - self._passed_at_s > STUCK_S
        if stamp < self._newest[number] or stuck:
            went_on = self.release()
            self._newest = [-math.inf] * len(self._names)
            self._passed = -math.inf
        elif stamp < self._passed:
            self._newest[number] = stamp
            self.counts[number].late += 1
            raise DataError(
                f'sensor {name}: a frame is {self._passed - stamp:.3g} s older than those that '
                'went on without it (sensor_wait_s is how long they wait)')
        self._newest[number] = stamp
        heapq.heappush(self._held, (stamp, number, frame.index, frame))
        return went_on + self.due(frame.arrival_s)

    def due(self, now_s: float) -> list[StreamFrame]:
        """Return the frames that need not wait any longer at a time of the monotonic clock."""
        went_on = []
        while self._held:
            stamp, _, _, frame = self._held[0]
            behind = {n for n in self._waited_for if self._newest[n] < stamp}
            if behind and now_s < frame.arrival_s + self._wait_s:
                break
            self._waited_for -= behind
            went_on.append(self._pass(now_s))
        return went_on

    def release(self) -> list[StreamFrame]:
        """Return all frames that wait."""
        return [self._pass(self._held[0][-1].arrival_s) for _ in range(len(self._held))]

    def _pass(self, now_s: float) -> StreamFrame:
        stamp, _, _, frame = heapq.heappop(self._held)
        self._passed, self._passed_at_s = stamp, now_s
        self._n_passed += 1
        return replace(frame, pixels=padded(frame.pixels, self._shapes), index=self._n_passed - 1)


def _size(shape: tuple[int, ...]) -> str:
    return f'{shape[0]} x {shape[1]} (height x width)'
