"""Recordings in video files."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.read_errors import closed_on_error, read_errors
from track_before_detect.recordings.recording import Recording

VIDEO_SUFFIXES = ('.mp4', '.avi', '.mkv', '.mov')
# VP8 keeps pictures that are never shown in packets of their own.
_HIDDEN_PICTURES = ('vp8',)


def open_video(path: Path) -> Recording:
    """Open a video in which every picture of the first video stream is a frame.

    Colour becomes luminance: of YUV the luma samples as they are stored, because a change of
    their range would round them. Stamps are the presentation times of the stream.
    """
    if path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    container = _opened(path)
    with closed_on_error(container), read_errors(f'{path} cannot be read', _av_errors()):
        index = _indexed(path, container)
    source = _VideoSource(path, container, index)
    with closed_on_error(source):
        first = source.read(0)
    return Recording(path.name, first.shape, first.dtype, len(index.stamps), source, index.stamps)


@dataclass(frozen=True)
class _Index:
    """Where the frames of a video are.

    Attributes
    ----------
    stamps : array, shape (T,)
        Seconds.
    times : array of int, shape (T,)
        Presentation time of each frame, in units of the stream; None when frames can only be
        told apart by counting them from the first one.
    keys : array of int, shape (K,)
        Frames that can be decoded without those before; frame 0 is the first.
    """

    stamps: NDArray[np.float64]
    times: NDArray[np.int64] | None
    keys: NDArray[np.int64]


def _opened(path: Path, options: dict[str, str] | None = None) -> Any:
    av = _import_av()
    with read_errors(f'{path} is not a video, or an incomplete one', _av_errors()):
        # Without its protocol, what stands before a colon in a name would be taken for one.
        return av.open(f'file:{path}', options=options)


def _stream(path: Path, container: Any) -> Any:
    """Return the first video stream that is no cover picture."""
    cover = int(_import_av().stream.Disposition.attached_pic)
    for stream in container.streams.video:
        if not int(stream.disposition) & cover:
            return stream
    raise DataError(f'{path} holds no video stream')


def _indexed(path: Path, container: Any) -> _Index:
    """Find all frames of a video, decoding none where their packets tell enough."""
    stream = _stream(path, container)
    packets = [packet for packet in container.demux(stream)
               if packet.size and not packet.is_discard]
    if not packets:
        raise DataError(f'{path} holds no frames')
    _require_whole(path, container, stream, packets)
    unit = float(stream.time_base)
    shown = [packet.pts for packet in packets]
    all_keys = all(packet.is_keyframe for packet in packets)
    # AVI stores no presentation times; those of pictures that are stored out of order are guesses.
    guessed = container.format.name == 'avi' and not all_keys
    if (guessed or None in shown or len(set(shown)) < len(shown)
            or stream.codec_context.name in _HIDDEN_PICTURES):
        return _counted(path, container, stream, packets)
    first_key = next((k for k, packet in enumerate(packets) if packet.is_keyframe), 0)
    # What comes before the first key frame, or refers to what did, is never shown.
    start = packets[first_key].pts
    usable = [packet for packet in packets[first_key:] if packet.pts >= start]
    times = np.sort([packet.pts for packet in usable])
    keys = np.searchsorted(times, np.sort([p.pts for p in usable if p.is_keyframe]))
    return _Index(times * unit, times, np.union1d([0], keys))


def _require_whole(path: Path, container: Any, stream: Any, packets: list[Any]) -> None:
    """Refuse a video that holds less than it says."""
    if container.format.name.startswith('mov'):
        n_stored = len(packets)
        if n_stored < stream.frames:
            # An edit list may hide frames that are there.
            with _opened(path, {'advanced_editlist': '0'}) as whole:
                n_stored = sum(bool(packet.size)
                               for packet in whole.demux(whole.streams[stream.index]))
        if n_stored < stream.frames:
            raise DataError(f'{path} is truncated: it holds {n_stored} of {stream.frames} frames')
        return
    unit = float(stream.time_base)
    if container.format.name == 'avi':
        # Counts the places of frames, also those that hold none.
        announced = stream.frames * unit
    else:
        hours, minutes, seconds = stream.metadata.get('DURATION', '0:0:0').split(':')
        announced = 3600 * int(hours) + 60 * int(minutes) + float(seconds)
    times = np.sort([p.dts if p.pts is None else p.pts for p in packets
                     if p.pts is not None or p.dts is not None]) * unit
    longest = max(np.diff(times).max(initial=0.0), max(p.duration or 0 for p in packets) * unit)
    if len(times) and times[-1] + 2 * longest < announced:
        raise DataError(
            f'{path} is truncated: its frames end after {times[-1]:.3f} of {announced:.3f} s')


def _counted(path: Path, container: Any, stream: Any, packets: list[Any]) -> _Index:
    """Find all frames of a video by decoding it."""
    stored = sorted(packet.dts for packet in packets if packet.dts is not None)
    container.seek(0)
    shown = [frame.pts for frame in container.decode(stream)]
    if not shown:
        raise DataError(f'{path} holds no frames that can be decoded')
    # One frame for each packet: they are shown at the times of the packets, in order.
    times = stored if len(stored) == len(shown) else shown
    if None in times:
        raise DataError(f'{path} holds frames without a time')
    return _Index(np.array(times) * float(stream.time_base), None, np.zeros(1, np.int64))


class _VideoSource:
    """Decodes forwards, and from the key frame before when asked for another frame."""

    def __init__(self, path: Path, container: Any, index: _Index) -> None:
        self._path = path
        self._container = container
        self._index = index
        self._places = ({} if index.times is None else
                        {int(time): k for k, time in enumerate(index.times)})
        self._decoded: Iterator[tuple[int, Any]] = iter(())
        # No frame before this one comes from the decoder any more.
        self._next = len(index.stamps)

    def read(self, index: int) -> NDArray:
        message = f'frame {index} of {self._path} cannot be decoded'
        with read_errors(message, _av_errors()):
            picture = self._decode(index)
        if picture is None:
            raise DataError(message)
        return _pixels(picture)

    def close(self) -> None:
        self._container.close()

    def _decode(self, index: int) -> Any:
        """Return the picture of a frame; None when there is none."""
        key = int(self._index.keys[np.searchsorted(self._index.keys, index, 'right') - 1])
        try:
            if not key <= self._next <= index:
                self._start(key)
            picture = self._picture(index)
            if picture is None:
                # Some containers do not find their key frames; from its start all are found.
                self._start(0)
                picture = self._picture(index)
        except BaseException:
            # Where the decoder is now is not known.
            self._next = len(self._index.stamps)
            raise
        return picture

    def _start(self, key: int) -> None:
        """Let the decoder begin at a key frame."""
        if key == 0:
            self._container.close()
            self._container = _opened(self._path)
        stream = _stream(self._path, self._container)
        if not stream.codec_context.is_open:
            # Several frames at a time, on all cores.
            stream.thread_type = 'AUTO'
        if key > 0:
            assert self._index.times is not None
            self._container.seek(int(self._index.times[key]), stream=stream)
        self._decoded = self._numbered(self._container.decode(stream))
        self._next = key

    def _numbered(self, pictures: Iterator[Any]) -> Iterator[tuple[int, Any]]:
        """Yield pictures with the number of their frame."""
        if self._index.times is None:
            yield from enumerate(pictures)
            return
        for picture in pictures:
            number = self._places.get(picture.pts)
            if number is not None:
                yield number, picture

    def _picture(self, index: int) -> Any:
        """Return a picture that the decoder has yet to come to; None when it does not."""
        for number, picture in self._decoded:
            # Before the key frame that it began with, pictures may be damaged.
            if number >= self._next:
                self._next = number + 1
            if number == index:
                return picture
            if number > index:
                break
        self._next = len(self._index.stamps)
        return None


def _pixels(picture: Any) -> NDArray:
    """Return the luminance of a picture, shape (H, W)."""
    form = picture.format
    first = form.components[0]
    if form.is_rgb or form.has_palette:
        deep = max(component.bits for component in form.components) > 8
        return luminance(picture.to_ndarray(format='rgb48le' if deep else 'rgb24'))
    beside_others = sum(part.plane == first.plane for part in form.components) > 1
    if beside_others or form.is_bit_stream or picture.planes[0].line_size < 0:
        # Packed samples are only put in another order.
        several = len(form.components) > 2
        picture = picture.reformat(format={
            (True, True): 'yuv422p16le', (True, False): 'yuv422p',
            (False, True): 'gray16le', (False, False): 'gray'}[several, first.bits > 8])
        form = picture.format
    plane = picture.planes[0]
    kind = np.dtype('u1' if first.bits <= 8 else 'f4' if first.bits == 32 else 'u2')
    stored = kind.newbyteorder('>' if form.is_big_endian else '<')
    rows = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
    return np.ascontiguousarray(rows[:, :plane.width * kind.itemsize]).view(stored).astype(kind)


def _import_av() -> Any:
    try:
        import av
    except ImportError as error:
        raise MissingExtraError(
            "reading videos needs PyAV: pip install 'track_before_detect[video]'") from error
    return av


def _av_errors() -> tuple[type[Exception], ...]:
    """Return what damaged files raise in PyAV."""
    return _import_av().error.FFmpegError, OSError, EOFError, ValueError, RuntimeError
