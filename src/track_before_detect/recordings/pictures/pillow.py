"""Pictures that Pillow reads, with the low byte of 16-bit colour that it leaves out."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.read_errors import IMAGE_ERRORS, read_errors, reader_module

_GREY_MODES = ('L', 'I', 'F', 'I;16', 'I;16L', 'I;16B', 'I;16N')


def read_pillow_image(file: Path) -> NDArray:
    """Return the pixels of an image file, shape (H, W), colour as luminance."""
    return decode_pillow_image(file.read_bytes(), f'image {file}')


def decode_pillow_image(data: bytes, name: str) -> NDArray:
    """Return the pixels in the bytes of an image file, shape (H, W), colour as luminance."""
    pillow = reader_module('PIL.Image', 'Pillow', 'images')
    with (read_errors(f'{name} cannot be read', IMAGE_ERRORS),
          pillow.open(io.BytesIO(data)) as image):
        raw = image.tile[0][3] if image.tile else None
        if raw in ('LA;16B', 'RGB;16B', 'RGBA;16B'):
            with pillow.open(io.BytesIO(data)) as again:
                return _deep_pixels(image, again, raw)
        return pillow_pixels(image)


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
