"""From messages of any input to frames with a stamp, or to a sentence that says why not."""

from collections.abc import Callable
import os
import time
from typing import NamedTuple

from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.clock import Clock
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Float32MultiArray, Header

from track_before_detect.errors import DataError
from track_before_detect.recordings.encodings import multiarray_stamp
from track_before_detect.recordings.pictures.pillow import decode_compressed_image
from track_before_detect.ros import conversions

HEADER, ARRIVAL, STEADY = 'header', 'arrival', 'steady'
RAW, COMPRESSED = 'raw', 'compressed'
# Recordings and simulations may begin at zero, and again when they loop; a clock that shows more,
# 11 days, was set.
LATEST_FROM_ZERO_S = 10**6


class StampedFrame(NamedTuple):
    """Pixels (H, W), their stamp in seconds, and the header of what is found in them."""

    pixels: NDArray
    stamp_s: float
    header: Header


class FrameReader:
    """Reads frames out of messages; DataError says what is wrong with one.

    Parameters
    ----------
    stamp_source : {'header', 'arrival', 'steady'}
        Where the stamp of a frame comes from: the message, or its arrival by the node's clock, or
        by one that starts at the time of day and never jumps or stands still. An array without a
        label that stamps it has that of its arrival in any case.
    shape : tuple of int
        Height and width that were told, zero where unknown.
    clock : Clock
        Of the node.
    warn : callable
        Takes a kind, for throttling, and a sentence.
    """

    def __init__(self, stamp_source: str, shape: tuple[int, int], clock: Clock,
                 warn: Callable[[str, str], None]) -> None:
        self._source = stamp_source
        self._shape = shape if min(shape) > 0 else None
        self._clock = clock
        self._warn = warn
        self._steady_offset_s = time.time() - time.monotonic()
        # None that a message could have, before the first.
        self._last_stamp = Time(sec=-1)
        self._last_arrival = Time()

    def image(self, message: Image) -> StampedFrame:
        """Return the frame in an image."""
        header = self._stamped(message.header)
        pixels = conversions.frame_from_image(message)
        self._check_rest(len(message.data) - message.step * message.height, 'bytes')
        return _frame(pixels, header)

    def compressed_image(self, message: CompressedImage) -> StampedFrame:
        """Return the frame in a PNG or JPEG, 16 bits kept."""
        header = self._stamped(message.header)
        return _frame(decode_compressed_image(bytes(message.data), message.format), header)

    def multiarray(self, message: Float32MultiArray) -> StampedFrame:
        """Return the frame in an array, which has the size told where its layout names none."""
        dim = message.layout.dim
        stamp = multiarray_stamp(one.label for one in dim)
        header = self._arrived('') if stamp is None else self._stamped(
            Header(stamp=Time(sec=stamp.sec, nanosec=stamp.nanosec), frame_id=stamp.frame_id))
        pixels = conversions.frame_from_multiarray(message, self._shape)
        rows = dim[0].size * dim[1].stride if len(dim) > 1 else 0
        whole = max(pixels.size, rows, dim[0].stride if dim else 0)
        self._check_rest(len(message.data) - message.layout.data_offset - whole, 'items')
        return _frame(pixels, header)

    def _stamped(self, header: Header) -> Header:
        """Return a header with the stamp that counts."""
        if self._source != HEADER:
            return self._arrived(header.frame_id)
        if header.stamp.nanosec >= 10**9:
            raise DataError('nanosec of header.stamp must be below 1e9, got '
                            f'{header.stamp.nanosec}')
        last, self._last_stamp = self._last_stamp, header.stamp
        if header.stamp == Time() and (last == Time() or last.sec > LATEST_FROM_ZERO_S):
            self._last_stamp = last
            raise DataError('header.stamp is 0, which is taken for none: the publisher must fill '
                            'it in, or stamp_source=arrival takes the time of arrival')
        return header

    def _arrived(self, frame_id: str) -> Header:
        if self._source == STEADY:
            now = conversions.time_from_seconds(self._steady_offset_s + time.monotonic())
        else:
            now = self._clock.now().to_msg()
        if now == self._last_arrival:
            raise DataError(f'the clock of the node stands still at {now.sec} s, so frames have '
                            'no time of arrival: stamp_source=steady takes that of a clock that '
                            'never does')
        self._last_arrival = now
        return Header(stamp=now, frame_id=frame_id)

    def _check_rest(self, n_over: int, what: str) -> None:
        """Warn of data that no pixel is made of: the sender has another layout in mind."""
        if n_over > 0:
            self._warn('rest', f'a message holds {n_over} {what} more than its size says, which '
                       'are not used: are height, width and step right?')


def larger_segment_words() -> str:
    """Return how large frames get through Fast DDS, empty where that is seen to."""
    if os.environ.get('FASTRTPS_DEFAULT_PROFILES_FILE') or os.environ.get(
            'FASTDDS_DEFAULT_PROFILES_FILE'):
        return ''
    return ('; frames of 1 MB and more need FASTRTPS_DEFAULT_PROFILES_FILE='
            'share/track_before_detect/config/fastdds_profile.xml, as the launch files set it, in '
            'both nodes, or reliable:=true')


def _frame(pixels: NDArray, header: Header) -> StampedFrame:
    return StampedFrame(pixels, conversions.seconds_from_time(header.stamp), header)
