"""Which chunks of an MCAP file are damaged, by their checksums (https://mcap.dev/spec)."""

from collections.abc import Iterator
import importlib
from pathlib import Path
import struct
import sys
from typing import BinaryIO
import zlib

_MAGIC_BYTES = 8
_CHUNK = 0x06
_RECORD = struct.Struct('<BQ')
# First and last time (ns), size and checksum of what is packed.
_CHUNK_HEADER = struct.Struct('<QQQI')
_LENGTH, _LONG_LENGTH = struct.Struct('<I'), struct.Struct('<Q')
# Packages that bags of that compression need anyway.
_ZSTD = 'compression.zstd' if sys.version_info >= (3, 14) else 'backports.zstd'
_UNPACKERS = {'lz4': 'lz4.frame', 'zstd': _ZSTD}


def damaged_spans(path: Path) -> list[tuple[int, int]]:
    """Return the first and last time (ns) of the messages in each chunk that is damaged.

    Parameters
    ----------
    path : Path
        An MCAP file, or a folder of them.
    """
    files = sorted(path.glob('*.mcap')) if path.is_dir() else [path]
    spans = []
    for name in files:
        with open(name, 'rb') as file:
            spans += [span for span, is_sound in _chunks(file) if not is_sound]
    return sorted(spans)


def _chunks(file: BinaryIO) -> Iterator[tuple[tuple[int, int], bool]]:
    """Yield the times of each chunk, and whether its checksum holds."""
    file.seek(_MAGIC_BYTES)
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        kind, length = _RECORD.unpack(head)
        if kind != _CHUNK:
            file.seek(length, 1)
            continue
        record = file.read(length)
        if len(record) < _CHUNK_HEADER.size:
            return
        first, last, size, checksum = _CHUNK_HEADER.unpack_from(record)
        try:
            data = _unpacked(record[_CHUNK_HEADER.size:])
            is_sound = len(data) == size and checksum in (0, zlib.crc32(data))
        except Exception:
            # Whatever an unpacker says of damaged data.
            is_sound = False
        yield (first, last), is_sound


def _unpacked(record: bytes) -> bytes:
    """Return the messages of a chunk, of which the name of a compression comes first."""
    (length,) = _LENGTH.unpack_from(record)
    start = _LENGTH.size + length
    compression = record[_LENGTH.size:start].decode()
    (n_bytes,) = _LONG_LENGTH.unpack_from(record, start)
    data = record[start + _LONG_LENGTH.size:][:n_bytes]
    if not compression:
        return data
    return importlib.import_module(_UNPACKERS[compression]).decompress(data)
