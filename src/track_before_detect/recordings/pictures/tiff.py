"""Recordings in TIFF files: pages, stacks with named axes, their frame interval."""

from pathlib import Path
from types import ModuleType
from typing import Any
import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.pictures.pillow import pillow_pixels
from track_before_detect.recordings.read_errors import (
    closed_on_error,
    IMAGE_ERRORS,
    read_errors,
    reader_module,
)
from track_before_detect.recordings.recording import FrameSource, MappedSource, Recording

TIFF_SUFFIXES = ('.tif', '.tiff')
# What the letters of other axes than those of a picture stand for.
_AXES = {'T': 'frames', 'C': 'channels', 'Z': 'slices'}
_UNITS_S = {'s': 1.0, 'sec': 1.0, 'second': 1.0, 'seconds': 1.0, 'ms': 1e-3, 'msec': 1e-3,
            'us': 1e-6, 'µs': 1e-6, 'usec': 1e-6, 'ns': 1e-9, 'min': 60.0, 'h': 3600.0}
# Types and colours that Pillow decodes to the same values.
_PILLOW_TYPES = ('uint8', 'uint16', 'int16', 'int32', 'float32')
_GREY, _RGB, _PALETTE, _YCBCR = 1, 2, 3, 6


def read_tiff_image(file: Path) -> NDArray:
    """Return the first page of a TIFF file, shape (H, W), colour as luminance."""
    tifffile = _import_tifffile()
    with read_errors(f'image {file} cannot be read', (*IMAGE_ERRORS, tifffile.TiffFileError)):
        source = _TiffSource(file, tifffile.TiffFile(file), tifffile)
        with closed_on_error(source):
            frame = source.decode(0)
        source.close()
        return frame


def open_tiff(path: Path) -> Recording:
    """Open a TIFF file in which every page is a frame.

    The interval between frames is that of ImageJ's or OME's metadata. A file whose pages differ
    in more than one axis, such as time and channel, is refused.
    """
    tifffile = _import_tifffile()
    errors = (*IMAGE_ERRORS, tifffile.TiffFileError)
    with read_errors(f'{path} is not a complete TIFF file', errors):
        tiff = tifffile.TiffFile(path)
    with closed_on_error(tiff), read_errors(f'{path} cannot be read', errors):
        return _open_tiff(path, tiff, tifffile)


def _open_tiff(path: Path, tiff: Any, tifffile: ModuleType) -> Recording:
    source: FrameSource
    n_pages = len(tiff.pages)
    if n_pages == 0:
        raise DataError(f'{path} holds no pages')
    series = tiff.series
    if tiff.is_ome and len(series) > 1:
        raise DataError(f'{path} holds {len(series)} series of images; save one of them alone')
    axis = _axis_of_frames(path, series[0])
    if n_pages == 1:
        # Large ImageJ stacks declare a single page and append the other frames.
        if not axis or 'S' in series[0].axes:
            raise DataError(
                f'{path} holds a single image; a recording needs one page per frame, or a folder '
                'of images')
        volume = tifffile.memmap(path, mode='r')
        volume = volume.reshape(-1, *volume.shape[-2:])
        n_frames, source = len(volume), MappedSource(volume, tiff)
    else:
        n_frames, source = n_pages, _TiffSource(path, tiff, tifffile)
    first = source.read(0)
    recording = Recording(path.name, first.shape, first.dtype, n_frames, source,
                          _stamps(tiff, n_frames))
    if axis in ('C', 'Z'):
        recording.remarks.append(f'the {n_frames} {_AXES[axis]} of {path.name} are read as frames')
    return recording


def _axis_of_frames(path: Path, series: Any) -> str:
    """Return the letter of the axis beside those of a picture, empty when there is none."""
    axes = [(axis, length) for axis, length in zip(series.axes, series.shape, strict=True)
            if axis not in 'YXS' and length > 1]
    if len(axes) > 1:
        found = ' x '.join(f'{length} {_AXES.get(axis, "pages")}' for axis, length in axes)
        raise DataError(f'{path} must hold nothing but frames, got {found} (axes {series.axes}); '
                        'save one channel and slice alone')
    return axes[0][0] if axes else ''


def _stamps(tiff: Any, n_frames: int) -> NDArray[np.float64] | None:
    """Return the stamps that ImageJ's or OME's metadata tell; None when they tell none."""
    interval: Any = 0
    unit = 's'
    if tiff.is_imagej:
        metadata = tiff.imagej_metadata or {}
        interval, unit = metadata.get('finterval', 0), metadata.get('tunit', unit)
    elif tiff.is_ome:
        pixels = ElementTree.fromstring(tiff.ome_metadata).find('.//{*}Pixels')
        if pixels is None:
            return None
        planes = {int(plane.get('TheT', 0)): plane for plane in pixels.iterfind('{*}Plane')
                  if plane.get('DeltaT')}
        stamps = np.array([_seconds(plane.get('DeltaT'), plane.get('DeltaTUnit', unit))
                           for _, plane in sorted(planes.items())])
        if len(stamps) == n_frames and np.isfinite(stamps).all() and np.ptp(stamps) > 0:
            return stamps
        interval = pixels.get('TimeIncrement', 0)
        unit = pixels.get('TimeIncrementUnit', unit)
    seconds = _seconds(interval, unit)
    return np.arange(n_frames, dtype=float) * seconds if 0 < seconds < np.inf else None


def _seconds(value: Any, unit: str) -> float:
    """Return a duration in seconds; NaN when its unit is not known."""
    return float(value) * _UNITS_S.get(unit.strip().lower(), np.nan)


class _TiffSource:
    """Reads one page per frame."""

    def __init__(self, path: Path, tiff: Any, tifffile: ModuleType) -> None:
        self._path = path
        self._tiff = tiff
        self._errors = (*IMAGE_ERRORS, tifffile.TiffFileError)
        # The same file, once tifffile could not decode a page of it.
        self._pillow: Any = None

    def read(self, index: int) -> NDArray:
        with read_errors(f'page {index} of {self._path} cannot be read', self._errors):
            return self.decode(index)

    def decode(self, index: int) -> NDArray:
        """Return one page as a frame; what is raised is that of the libraries."""
        page = self._tiff.pages[index]
        # What the pages of a series share; the others may not know it themselves.
        shared = page.keyframe
        try:
            pixels = page.asarray()
        except ValueError as error:
            # Only a package that is not installed knows the compression.
            if 'imagecodecs' not in str(error):
                raise
            return self._decode_with_pillow(index, shared)
        if shared.photometric == _PALETTE:
            # Of 16 bits, whatever the pixels have; some write the upper 8 bits alone.
            return luminance((np.moveaxis(shared.colormap, 0, -1) >> 8)[pixels])
        if page.axes == 'YX':
            return pixels.astype(pixels.dtype.newbyteorder('='), copy=False)
        if page.axes == 'SYX':
            pixels = np.moveaxis(pixels, 0, -1)
        if page.axes in ('YXS', 'SYX') and pixels.shape[-1] in (3, 4):
            return luminance(pixels)
        if page.axes in ('YXS', 'SYX') and pixels.shape[-1] == 2:
            return np.ascontiguousarray(pixels[..., 0])
        raise DataError(
            f'a page of {self._path} must be grey or colour (H, W), got axes {page.axes} of shape '
            f'{pixels.shape}')

    def _decode_with_pillow(self, index: int, page: Any) -> NDArray:
        colour = page.photometric in (_RGB, _PALETTE, _YCBCR)
        if not (colour and page.dtype == np.uint8
                or page.photometric == _GREY and page.dtype.name in _PILLOW_TYPES):
            raise MissingExtraError(
                f'reading {self._path} ({page.compression.name} of {page.dtype}) needs '
                'imagecodecs: pip install imagecodecs')
        if self._pillow is None:
            self._pillow = reader_module('PIL.Image', 'Pillow', 'images').open(self._path)
        self._pillow.seek(index)
        pixels = pillow_pixels(self._pillow)
        # Pillow has no signed 16-bit pixels, and holds them in wider ones.
        return pixels if colour else pixels.astype(page.dtype, copy=False)

    def close(self) -> None:
        if self._pillow is not None:
            self._pillow.close()
        self._tiff.close()


def _import_tifffile() -> ModuleType:
    return reader_module('tifffile', 'tifffile', 'TIFF files')
