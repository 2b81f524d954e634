"""Pictures that Pillow reads, with the low byte of 16-bit colour that it leaves out."""

from collections.abc import Sequence
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.recordings.encodings import grey_of_mosaic, luminance
from track_before_detect.recordings.read_errors import IMAGE_ERRORS, read_errors, reader_module

# What messages hold. Decoders of other formats do far more than decode, and are kept out of reach.
_MESSAGE_FORMATS = ('PNG', 'JPEG')
# Of a picture in a message: a few kilobytes may unpack to gigabytes.
MOST_PIXELS = 2**26
_GREY_MODES = ('L', 'I', 'F', 'I;16', 'I;16L', 'I;16B', 'I;16N')


def read_pillow_image(file: Path) -> NDArray:
    """Return the pixels of an image file, shape (H, W), colour as luminance."""
    return decode_pillow_image(file.read_bytes(), f'image {file}')


def decode_compressed_image(data: bytes, description: str) -> NDArray:
    """Return the pixels (H, W) of a CompressedImage message that holds a PNG or JPEG.

    Parameters
    ----------
    data : bytes
        Of the message.
    description : str
        Its ``format``, such as ``'mono16; png compressed '``.
    """
    name = f'its {description or "picture"}'
    pixels = decode_pillow_image(data, name, _MESSAGE_FORMATS, MOST_PIXELS)
    # Coders of pictures in colour take the mosaic away before.
    is_mosaic = description.startswith('bayer_') and 'compressed bgr' not in description
    return grey_of_mosaic(pixels) if is_mosaic else pixels


def decode_pillow_image(data: bytes, name: str, formats: Sequence[str] | None = None,
                        most_pixels: float = float('inf')) -> NDArray:
    """Return the pixels in the bytes of an image file, shape (H, W), colour as luminance.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        For errors.
    formats : sequence of str, optional
        Those that are decoded, as Pillow names them; all unless given.
    most_pixels : float
        Of a picture that is decoded.
    """
    pillow = reader_module('PIL.Image', 'Pillow', 'images')
    with (read_errors(f'{name} cannot be read', (*IMAGE_ERRORS, pillow.DecompressionBombError)),
          _opened(pillow, data, formats) as image):
        if image.width * image.height > most_pixels:
            raise DataError(f'{name} must have at most {most_pixels} pixels, got '
                            f'{image.height} x {image.width}')
        raw = image.tile[0][3] if image.tile else None
        if raw in ('LA;16B', 'RGB;16B', 'RGBA;16B'):
            with pillow.open(io.BytesIO(data)) as again:
                return _deep_pixels(image, again, raw)
        return pillow_pixels(image)


def _opened(pillow: Any, data: bytes, formats: Sequence[str] | None) -> Any:
    """Return an image of which no pixel is decoded yet."""
    try:
        return pillow.open(io.BytesIO(data), formats=formats)
    except pillow.UnidentifiedImageError as error:
        kinds = ' or '.join(formats or ['picture of a known kind'])
        # Its own words name a place in memory.
        raise ValueError(f'it is no {kinds}') from error


def pillow_pixels(image: Any) -> NDArray:
    """Return the pixels of an open image, shape (H, W), colour as luminance."""
    if image.mode in ('1', 'LA', 'La'):
        return np.array(image.convert('L'))
    if image.mode in _GREY_MODES:
        pixels = np.array(image)
        return pixels.astype(pixels.dtype.newbyteorder('='), copy=False)
    return luminance(np.asarray(image.convert('RGB')))


def _deep_pixels(image: Any, again: Any, raw: str) -> NDArray:
    """Return the pixels of a PNG of 16-bit colour, or of grey with transparency.

    Pillow keeps the high bytes alone. Told that the same bytes are four channels of 8 bits, or
    come in the other order, it gives the low ones.
    """
    if raw == 'LA;16B':
        _decode_as(image, 'RGBA')
        high, low = np.moveaxis(np.asarray(image, np.uint16)[..., :2], -1, 0)
        return high << 8 | low
    _decode_as(again, raw.replace('16B', '16L'))
    return luminance(np.asarray(image, np.uint16) << 8 | np.asarray(again, np.uint16))


def _decode_as(image: Any, raw: str) -> None:
    image.tile = [(*tile[:3], raw) for tile in image.tile]
