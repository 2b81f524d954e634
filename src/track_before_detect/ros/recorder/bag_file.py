"""An MCAP file that can be read whatever happens to the process that writes it."""

import errno
import os
from pathlib import Path
import struct
from typing import cast, IO

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import CompressionType, MCAP0_MAGIC, Writer

COMPRESSIONS = {'none': CompressionType.NONE, 'lz4': CompressionType.LZ4,
                'zstd': CompressionType.ZSTD}
# Kind and length of a record, a kind that the format leaves to applications and readers skip.
_SKIPPED, _PRIVATE = struct.Struct('<BQ'), 0x80
# What the file grows by beyond what is needed: a hole, which takes no room on the disk.
_GROWTH, _PAGE = 2**22, 4096
PROFILE, SCHEMA_ENCODING, MESSAGE_ENCODING = 'ros2', 'ros2msg', 'cdr'


class BagFile:
    """Writes serialized messages; what was committed can be read from then on.

    Parameters
    ----------
    path : Path
        Of a file that does not exist; OSError when it cannot be made.
    compression : {'none', 'lz4', 'zstd'}
        Of chunks.
    most_held : int
        Bytes that are held while they cannot be written; further messages are refused.
    """

    def __init__(self, path: Path, compression: str, most_held: int) -> None:
        self._file = _EndedFile(path)
        self._most_held = most_held
        self._writer = Writer(cast(IO[bytes], self._file), compression=COMPRESSIONS[compression])
        self._writer.start(PROFILE)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.commit()

    @property
    def n_bytes(self) -> int:
        """Number of bytes that are safe in the file."""
        return self._file.n_safe

    def add_topic(self, topic: str, kind: str, definition: str) -> None:
        """Get ready for the messages of a topic, of a type such as ``sensor_msgs/msg/Image``."""
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(
                kind, SCHEMA_ENCODING, definition.encode())
        self._channels[topic] = self._writer.register_channel(
            topic, MESSAGE_ENCODING, self._schemas[kind])

    def write(self, topic: str, data: bytes, received_ns: int, sent_ns: int) -> bool:
        """Take a serialized message; return False when too much is held already."""
        if self._file.n_held + len(data) > self._most_held:
            return False
        self._writer.add_message(self._channels[topic], received_ns, data, sent_ns)
        return True

    def commit(self) -> None:
        """Bring all that is held into the file; OSError when it stays held for another try."""
        self._writer.flush()
        self._file.commit()

    def close(self) -> None:
        """Write what is held and an index; after OSError the file is as it was, without index."""
        try:
            self.commit()
            self._writer.finish()
            self._file.commit(is_last=True)
        finally:
            self._file.close()


class _EndedFile:
    """What the writer takes for its file: holds what is written until it is committed.

    Between what is safe and the end of the file there is always a record that readers skip. What
    is committed is set into it first, where nobody sees it, then over its first bytes. Whenever
    the process is killed, also within a write, the file is whole.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        self._held = bytearray()
        # Of the contents of the record that is skipped; there is none yet.
        self._room = -_SKIPPED.size
        self.n_safe = 0
        end = RecordBuilder()
        DataEnd(0).write(end)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(end)
        self._end = bytes(end.end()) + MCAP0_MAGIC

    @property
    def n_held(self) -> int:
        return len(self._held)

    def write(self, data: bytes) -> int:
        self._held += data
        return len(data)

    def tell(self) -> int:
        return self.n_safe + len(self._held)

    def flush(self) -> None:
        """Nothing: a commit is asked for by itself."""

    def commit(self, is_last: bool = False) -> None:
        n_held, at = len(self._held), self.n_safe
        if not n_held:
            return
        if n_held > self._room:
            self._grow(n_held)
        room = self._room - n_held
        with memoryview(self._held) as view:
            self._put([view[_SKIPPED.size:], _SKIPPED.pack(_PRIVATE, room)], at + _SKIPPED.size)
            if is_last:
                # Now it ends with the index, which does not lead to what is skipped.
                os.ftruncate(self._descriptor, at + n_held)
            self._put([view[:_SKIPPED.size]], at)
        self.n_safe, self._room = at + n_held, room
        self._held.clear()

    def close(self) -> None:
        os.close(self._descriptor)

    def _grow(self, n_more: int) -> None:
        """Put a new end so far off that there is room for so much, and skip up to it."""
        size = -(-(self.n_safe + n_more + _GROWTH) // _PAGE) * _PAGE
        room = size - len(self._end) - self.n_safe - _SKIPPED.size
        if self.n_safe:
            # First, so that the old end, which is going to be in the middle, is not read.
            self._put([_SKIPPED.pack(_PRIVATE, room)], self.n_safe)
        try:
            # Within a page, which no signal interrupts.
            self._put([self._end], size - len(self._end))
        except OSError:
            if self.n_safe:
                self._put([_SKIPPED.pack(_PRIVATE, self._room)], self.n_safe)
            raise
        self._room = room

    def _put(self, parts: list[bytes | memoryview], at: int) -> None:
        if os.pwritev(self._descriptor, parts, at) < sum(map(len, parts)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
