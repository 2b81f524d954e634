"""Recordings in bags of ROS 2 and ROS 1, read without ROS."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.recordings.encodings import (
    decode_image,
    LabelledStamp,
    multiarray_stamp,
    multiarray_to_frame,
)
from track_before_detect.recordings.mcap_chunks import damaged_spans
from track_before_detect.recordings.pictures.pillow import decode_compressed_image
from track_before_detect.recordings.read_errors import closed_on_error, read_errors
from track_before_detect.recordings.recording import Recording

ROS1_SUFFIX = '.bag'
BAG_SUFFIXES = ('.db3', '.mcap', ROS1_SUFFIX)
PACKED_BAG_SUFFIXES = ('.db3.zstd', '.mcap.zstd')
IMAGE_TYPE = 'sensor_msgs/msg/Image'
ARRAY_TYPE = 'std_msgs/msg/Float32MultiArray'
_TYPES = (IMAGE_TYPE, ARRAY_TYPE)
# Read as well, but not chosen where there are others: most lose what is dim.
COMPRESSED_TYPE = 'sensor_msgs/msg/CompressedImage'
# The bag library lets errors of sqlite, compression and YAML through.
_READ_ERRORS = (Exception,)


def find_bag(folder: Path) -> Path | None:
    """Return what to open as a bag in a folder, or None when it is not one.

    A folder whose ``metadata.yaml`` was never written, because the recorder was killed, is
    opened through its only storage file.
    """
    files = [file for file in folder.iterdir() if file.suffix in BAG_SUFFIXES]
    if (folder / 'metadata.yaml').exists():
        return folder
    if len(files) > 1:
        raise DataError(
            f'{folder} has no metadata.yaml and {len(files)} storage files: open one of them, or '
            'run ros2 bag reindex')
    packed = [file for file in folder.iterdir() if file.name.endswith(PACKED_BAG_SUFFIXES)]
    if packed and not files:
        raise DataError(f'{folder} has no metadata.yaml, without which packed files are not read; '
                        f'zstd -d {packed[0]} unpacks one')
    return files[0] if files else None


def open_rosbag(path: Path, topic: str | None = None) -> Recording:
    """Open one topic of a bag: a folder, or a single ``.db3``, ``.mcap`` or ``.bag`` file.

    Stamps are those of the message headers; messages without header, or with empty ones, have
    the time at which they were received.
    """
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import get_typestore, Stores
    except ImportError as error:
        raise MissingExtraError(
            "reading bags needs rosbags: pip install 'track_before_detect[readers]'") from error
    if path.is_file() and path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    with read_errors(f'bag {path} cannot be opened', _READ_ERRORS):
        reader: Any
        if path.suffix == ROS1_SUFFIX:
            reader = rosbag1.Reader(path)
            deserialize = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
        else:
            reader = rosbag2.Reader(path)
            deserialize = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
        reader.open()
    with closed_on_error(reader):
        connections = _choose_topic(path, reader.connections, topic)
        return _BagSource(path, reader, connections, deserialize).scan()


def _choose_topic(path: Path, connections: Iterable[Any], topic: str | None) -> list[Any]:
    """Return the connections of the topic to read."""
    suitable = sorted({c.topic for c in connections if c.msgtype in _TYPES and c.msgcount})
    if not suitable:
        suitable = sorted({c.topic for c in connections
                           if c.msgtype == COMPRESSED_TYPE and c.msgcount})
    listed = ', '.join(suitable) or 'none'
    if topic is None:
        if len(suitable) != 1:
            raise DataError(
                f'{path} must have one topic of {IMAGE_TYPE}, {ARRAY_TYPE} or {COMPRESSED_TYPE} '
                f'with messages, or the topic must be named; found: {listed}')
        topic = suitable[0]
    chosen = [c for c in connections if c.topic.lstrip('/') == topic.lstrip('/')]
    if not chosen:
        raise DataError(f'{path} has no topic {topic}; suitable topics: {listed}')
    for connection in chosen:
        if connection.msgtype not in (*_TYPES, COMPRESSED_TYPE):
            raise DataError(
                f'topic {topic} of {path} must be {IMAGE_TYPE}, {ARRAY_TYPE} or '
                f'{COMPRESSED_TYPE}, got {connection.msgtype}; suitable topics: {listed}')
    return chosen


class _BagSource:
    """Reads messages forwards; a jump starts again at the time of the frame wanted."""

    def __init__(self, path: Path, reader: Any, connections: list[Any],
                 deserialize: Callable[[Any, str], Any]) -> None:
        self._path = path
        self._reader = reader
        self._connections = connections
        self._deserialize = deserialize
        self._received: list[int] = []
        # From when to when messages are read, all unless chunks are damaged.
        self._spans: list[tuple[int | None, int | None]] = [(None, None)]
        self._messages: Iterator[tuple[Any, int, bytes]] = iter(())
        self._next = -1
        self._closed = False

    def scan(self) -> Recording:
        """Read all messages once for their stamps, and return the recording."""
        try:
            header_stamps, frame_id, first = self._first_pass()
        except DataError:
            if not self._leave_out_damaged():
                raise
            header_stamps, frame_id, first = self._first_pass()
        name = self._path.resolve().name
        if first is None:
            raise DataError(f'topic {self._connections[0].topic} of {name} has no messages')
        stamps = 1e-9 * np.array(self._received, np.float64)
        if len(header_stamps) == len(stamps) and any(header_stamps):
            stamps = np.array(header_stamps)
        self._messages = iter(())
        self._next = -1
        recording = Recording(name, first.shape, first.dtype, len(stamps), self, stamps,
                              frame_id=frame_id)
        n_messages = sum(connection.msgcount for connection in self._connections)
        if len(stamps) < n_messages:
            recording.remarks.append(
                f'{n_messages - len(stamps)} of {n_messages} messages of {name} cannot be read '
                f'and are left out: {len(self._spans) - 1} of its chunks are damaged')
        return recording

    def _first_pass(self) -> tuple[list[float], str, NDArray | None]:
        """Return the stamps of all headers, the first name of a frame, and the first frame."""
        self._received = []
        header_stamps, frame_id, first = [], '', None
        self._start(0)
        for index, (received, message) in enumerate(self._iterate()):
            self._received.append(received)
            stamp = self._stamp(index, message)
            if stamp is not None:
                header_stamps.append(stamp.sec + 1e-9 * stamp.nanosec)
                frame_id = frame_id or stamp.frame_id
            if first is None:
                first = self._decode(index, message)
        return header_stamps, frame_id, first

    def _leave_out_damaged(self) -> bool:
        """Pass over the chunks whose checksum fails from now on; return whether there are any."""
        damaged = damaged_spans(self._path) if self._path.suffix != ROS1_SUFFIX else []
        self._spans = list(zip([None, *(last + 1 for _, last in damaged)],
                               [*(first for first, _ in damaged), None], strict=True))
        return bool(damaged)

    def _all_from(self, time: int | None) -> Iterator[tuple[Any, int, bytes]]:
        """Yield the messages received from a time on, without those of damaged chunks."""
        for start, stop in self._spans:
            begin = max((t for t in (start, time) if t is not None), default=None)
            if stop is None or begin is None or begin < stop:
                yield from self._reader.messages(self._connections, start=begin, stop=stop)

    def read(self, index: int) -> NDArray:
        if index != self._next:
            self._start(index)
        for _, message in self._iterate():
            self._next = index + 1
            return self._decode(index, message)
        raise DataError(f'message {index} of {self._path} has disappeared')

    def _start(self, index: int) -> None:
        """Let the next message be number ``index``."""
        if not self._received:
            self._messages = self._all_from(None)
            return
        time = self._received[index]
        self._messages = self._all_from(time)
        # Several messages may have been received at the same time.
        for _ in range(index - self._received.index(time)):
            next(self._messages)

    def _iterate(self) -> Iterator[tuple[int, Any]]:
        while True:
            with read_errors(f'bag {self._path} cannot be read to the end', _READ_ERRORS):
                item = next(self._messages, None)
                if item is None:
                    return
                connection, received, raw = item
                message = self._deserialize(raw, connection.msgtype)
            yield received, message

    def _stamp(self, index: int, message: Any) -> LabelledStamp | None:
        """Return what the header of a message says, or a label where it has none."""
        header = getattr(message, 'header', None)
        if header is not None:
            return LabelledStamp(header.stamp.sec, header.stamp.nanosec, header.frame_id)
        try:
            return multiarray_stamp(dim.label for dim in message.layout.dim)
        except DataError as error:
            raise DataError(f'message {index} of {self._path}: {error}') from error

    def _decode(self, index: int, message: Any) -> NDArray:
        try:
            if hasattr(message, 'encoding'):
                return decode_image(message.data, message.encoding, message.height,
                                    message.width, message.step, message.is_bigendian)
            if hasattr(message, 'format'):
                return decode_compressed_image(bytes(message.data), message.format)
            layout = message.layout
            return multiarray_to_frame(message.data, [dim.size for dim in layout.dim],
                                       [dim.stride for dim in layout.dim], layout.data_offset)
        except DataError as error:
            raise DataError(f'message {index} of {self._path}: {error}') from error

    def close(self) -> None:
        self._messages = iter(())
        if not self._closed:
            # Not every reader may be closed twice.
            self._closed = True
            self._reader.close()
