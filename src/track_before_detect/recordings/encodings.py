"""From the bytes of ROS messages to frames, without ROS."""

from collections.abc import Iterable, Sequence
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.errors import DataError

STAMP_LABEL = re.compile(r'stamp=([0-9]{1,10})\.([0-9]{9})(?: frame_id=(.{0,255}))?')
LUMINANCE_WEIGHTS = (0.299, 0.587, 0.114)

# Encoding: item type, channels, and which of them are red, green and blue, or the one that is grey
# (None: the pixels of a colour filter array).
_ENCODINGS: dict[str, tuple[str, int, tuple[int, ...] | None]] = {
    'mono8': ('u1', 1, (0,)),
    'mono16': ('u2', 1, (0,)),
    '8UC1': ('u1', 1, (0,)),
    '16UC1': ('u2', 1, (0,)),
    '16SC1': ('i2', 1, (0,)),
    '32FC1': ('f4', 1, (0,)),
    '64FC1': ('f8', 1, (0,)),
    # Real and imaginary part of complex numbers.
    '32FC2': ('c8', 1, (0,)),
    # Two pixels share their colour: luma and half of it in turn.
    'yuv422': ('u1', 2, (1,)),
    'uyvy': ('u1', 2, (1,)),
    'yuv422_yuy2': ('u1', 2, (0,)),
    'yuyv': ('u1', 2, (0,)),
    **{f'{colours}{8 * size}': (f'u{size}', len(colours), tuple(map(colours.index, 'rgb')))
       for colours in ('rgb', 'bgr', 'rgba', 'bgra') for size in (1, 2)},
    # Without names the channels are in the order of OpenCV.
    **{f'{8 * size}UC{channels}': (f'u{size}', channels, (2, 1, 0))
       for channels in (3, 4) for size in (1, 2)},
    **{f'bayer_{filters}{8 * size}': (f'u{size}', 1, None)
       for filters in ('rggb', 'bggr', 'gbrg', 'grbg') for size in (1, 2)},
}
ENCODINGS = tuple(_ENCODINGS)


def luminance(colour: NDArray, order: tuple[int, ...] = (0, 1, 2)) -> NDArray[np.float32]:
    """Return the luminance (ITU-R BT.601) of a colour image.

    Parameters
    ----------
    colour : array, shape (H, W, C)
        Channels last; channels not named by ``order`` (alpha) are ignored.
    order : tuple of three int
        Which channels are red, green and blue.

    Returns
    -------
    array of float32, shape (H, W)
        In the units of the channels; not rounded, because rounding would add noise.
    """
    grey = np.zeros(colour.shape[:2], np.float32)
    for channel, weight in zip(order, LUMINANCE_WEIGHTS, strict=True):
        grey += np.float32(weight) * colour[..., channel]
    return grey


def grey_of_mosaic(pixels: NDArray) -> NDArray[np.float32]:
    """Return the grey picture of a colour filter array, shape (H, W).

    Each pixel is the mean of the four blocks of 2 x 2 around it: a quarter red, half green and a
    quarter blue whatever the filter of the pixel is, so that the mosaic does not show and nothing
    is shifted.
    """
    # Mirrored at the outermost pixels the filters go on in turn.
    sums = np.pad(pixels.astype(np.float32), 1, mode='reflect')
    for _ in range(2):
        sums = sums[1:] + sums[:-1]
        sums = sums[:, 1:] + sums[:, :-1]
    return sums / np.float32(16)


def decode_image(data: Any, encoding: str, height: int, width: int, step: int,
                 is_bigendian: bool | int) -> NDArray:
    """Return the frame in the bytes of an image message.

    Parameters
    ----------
    data : bytes-like
        Rows of pixels.
    encoding : str
        One of :data:`ENCODINGS`; colour is turned to luminance, that of a filter array (bayer)
        to grey.
    height, width : int
        Size in pixels.
    step : int
        Length of a row in bytes, padding included.
    is_bigendian : bool or int
        Byte order of items longer than one byte.

    Returns
    -------
    array, shape (H, W)
        A copy in native byte order: uint8, uint16, int16, float32, float64 or complex64 as
        encoded, float32 for colour.
    """
    if encoding not in _ENCODINGS:
        raise DataError(f'image encoding must be one of {", ".join(ENCODINGS)}, got {encoding!r}')
    if height < 1 or width < 1:
        raise DataError(f'an image must have at least one pixel, got {height} x {width}')
    code, channels, order = _ENCODINGS[encoding]
    item = np.dtype(code)
    stored = item.newbyteorder('>' if is_bigendian else '<')
    row_bytes = width * channels * item.itemsize
    if step < row_bytes:
        raise DataError(
            f'step of a {encoding} image {width} pixels wide must be at least {row_bytes} bytes, '
            f'got {step}')
    buffer = memoryview(data).cast('B')
    # The last row may come without its padding.
    expected = step * (height - 1) + row_bytes
    if len(buffer) < expected:
        raise DataError(
            f'a {encoding} image of {height} x {width} with step {step} needs {expected} bytes, '
            f'got {len(buffer)}')
    strides = (step, channels * item.itemsize, item.itemsize)
    pixels = np.ndarray((height, width, channels), stored, buffer, strides=strides)
    if order is None:
        return grey_of_mosaic(pixels[..., 0])
    return pixels[..., order[0]].astype(item) if len(order) == 1 else luminance(pixels, order)


class LabelledStamp(NamedTuple):
    """Stamp and coordinate frame of an array, whose message has no header."""

    sec: int
    nanosec: int
    frame_id: str


def multiarray_stamp(labels: Iterable[str]) -> LabelledStamp | None:
    """Return the stamp in the labels of the dimensions of a std_msgs multi-array, if any.

    One of them may be ``stamp=SECONDS.NANOSECONDS frame_id=NAME``, the nanoseconds in nine digits
    and the name left out where there is none. It goes with the frame, so that none is lost alone.

    Raises
    ------
    DataError
        A label begins like that but is none.
    """
    for label in labels:
        if label.startswith('stamp='):
            match = STAMP_LABEL.fullmatch(label)
            if match is None or int(match[1]) >= 2**31:
                raise DataError('a label with a stamp must be stamp=SECONDS.NANOSECONDS '
                                f'frame_id=NAME, nine digits after the point, got {label[:80]!r}')
            return LabelledStamp(int(match[1]), int(match[2]), match[3] or '')
    return None


def multiarray_to_frame(data: ArrayLike, dim_sizes: Sequence[int], dim_strides: Sequence[int],
                        data_offset: int = 0) -> NDArray:
    """Return the frame in a std_msgs multi-array message.

    Element (i, j) of a layout with two dimensions is ``data[data_offset + dim[1].stride * i +
    j]``, as the message definition says; the stride of the first dimension is the number of
    items altogether and is not used. Strides of 0 stand for rows without gaps.

    Parameters
    ----------
    data : array, shape (N,)
        Items of the message.
    dim_sizes, dim_strides : sequence of int
        ``size`` and ``stride`` of each dimension of the layout. One dimension is a 1-D sensor
        and gives a single row; of more than two, all but two must have size 1.
    data_offset : int
        Items before the first element.

    Returns
    -------
    array, shape (H, W)
        A copy with the type of ``data``.
    """
    items = np.asarray(data)
    sizes = [int(size) for size in dim_sizes]
    strides = [int(stride) for stride in dim_strides]
    if not sizes or len(sizes) != len(strides):
        raise DataError(
            'the layout of a multi-array must name the size and stride of its rows and columns, '
            f'got {len(sizes)} sizes and {len(strides)} strides')
    if min(sizes) < 1 or min(strides) < 0 or data_offset < 0:
        raise DataError(
            'the layout of a multi-array must have sizes of at least 1 and no negative stride or '
            f'offset, got sizes {sizes}, strides {strides} and offset {data_offset}')
    steps = strides[1:] + [1]
    inner = 1
    for axis in range(len(sizes) - 1, -1, -1):
        if axis < len(sizes) - 1:
            steps[axis] = steps[axis] or inner
        if sizes[axis] > 1 and steps[axis] < inner:
            raise DataError(
                f'the layout of a multi-array overlaps itself: stride {steps[axis]} is smaller '
                f'than the {inner} items it must step over (sizes {sizes}, strides {strides})')
        inner = max(inner, steps[axis]) * sizes[axis]
    needed = data_offset + 1 + sum((n - 1) * step for n, step in zip(sizes, steps, strict=True))
    if items.ndim != 1 or len(items) < needed:
        raise DataError(
            f'a multi-array with sizes {sizes}, strides {strides} and offset {data_offset} needs '
            f'{needed} items, got {items.size}')
    axes = [(n, step) for n, step in zip(sizes, steps, strict=True) if n > 1 or len(sizes) <= 2]
    if len(axes) > 2:
        raise DataError(f'a frame must have rows and columns alone, got sizes {sizes}')
    while len(axes) < 2:
        axes.insert(0, (1, needed))
    (height, row_step), (width, column_step) = axes
    first = data_offset + row_step * np.arange(height)
    return items[first[:, None] + column_step * np.arange(width)]
