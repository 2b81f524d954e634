"""Recordings in FITS files: a cube, an image for each frame, or a file for each frame."""

from collections.abc import Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.recordings.pictures.series import FileSeries
from track_before_detect.recordings.read_errors import (
    closed_on_error,
    IMAGE_ERRORS,
    read_errors,
    reader_module,
)
from track_before_detect.recordings.recording import Recording

FITS_SUFFIXES = ('.fits', '.fit', '.fts')
# Compressed as a whole, or image by image.
_PACKED_SUFFIXES = ('.gz', '.fz')
# Modified Julian date of the beginning of 1970.
_MJD_1970 = 40587


def is_fits(path: Path) -> bool:
    """Say by its name whether a file is FITS, packed or not."""
    named = path.with_suffix('') if path.suffix.lower() in _PACKED_SUFFIXES else path
    return named.suffix.lower() in FITS_SUFFIXES


def open_fits(path: Path) -> Recording:
    """Open the first cube of a FITS file, or its images where each is a frame.

    Axes of length one are passed over. Where there are images named SCI, others are not frames.
    """
    file = _opened(path)
    with closed_on_error(file), read_errors(f'{path} cannot be read', IMAGE_ERRORS):
        cube = next((unit for unit in _images(file) if len(unit.shape) > 2 and _n_frames(unit) != 1
                     and sum(length > 1 for length in unit.shape[:-2]) <= 1), None)
        pictures = _pictures(file)
        stamps = None
        if cube is not None:
            units, n_frames = [cube], _n_frames(cube)
        elif len(pictures) > 1 or any(len(unit.shape) > 2 for unit in pictures):
            units, n_frames = pictures, len(pictures)
            stamps = _stamps([unit.header for unit in pictures])
        else:
            found = ', '.join('x'.join(map(str, unit.shape)) for unit in _images(file))
            raise DataError(
                f'{path} must hold an image of three axes (T, H, W) or an image for each frame, '
                f'found {found or "no image"}')
        source = _FitsSource(path, file, units)
        first = source.read(0) if n_frames else np.zeros(units[0].shape[-2:])
        return Recording(path.name, first.shape, first.dtype, n_frames, source, stamps)


def open_fits_series(folder: Path, files: list[Path]) -> Recording:
    """Open files of one frame each, in the order of their stamps where they have some."""
    headers, units = [], []
    for path in files:
        file = _opened(path)
        with read_errors(f'{path} cannot be read', IMAGE_ERRORS):
            try:
                pictures = _pictures(file)
                if not pictures:
                    found = max((_n_frames(unit) for unit in _images(file)), default=0)
                    raise DataError(
                        f'{path} must hold one frame like each file of a folder, got {found}')
                headers.append(pictures[0].header)
                units.append(file.index_of(pictures[0]))
            finally:
                file.close()
    stamps = _stamps(headers)
    order = np.arange(len(files)) if stamps is None else np.argsort(stamps, kind='stable')
    source = FileSeries(lambda index: _read_unit(files[order[index]], units[order[index]]),
                        lambda index: f'frame {index}, {files[order[index]]},')
    first = source.read(0)
    return Recording(folder.resolve().name, first.shape, first.dtype, len(files), source,
                     None if stamps is None else stamps[order])


def _opened(path: Path) -> Any:
    fits = reader_module('astropy.io.fits', 'astropy', 'FITS files')
    if path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    with read_errors(f'{path} is not a FITS file', IMAGE_ERRORS):
        # Sections are read from the file by themselves; scaled ones could not be mapped.
        return fits.open(path, memmap=False)


def _images(file: Any) -> list[Any]:
    """Return the units of a file that hold an image."""
    return [unit for unit in file if unit.is_image and unit.shape]


def _n_frames(unit: Any) -> int:
    return math.prod(unit.shape[:-2])


def _pictures(file: Any) -> list[Any]:
    """Return the units that hold one frame; those named SCI alone where there are some."""
    pictures = [unit for unit in _images(file) if len(unit.shape) > 1 and _n_frames(unit) == 1]
    return [unit for unit in pictures if unit.name == 'SCI'] or pictures


def _stamps(headers: Sequence[Any]) -> NDArray[np.float64] | None:
    """Return when the frames were taken, in seconds since 1970; None where not all tell."""
    stamps = np.array([_stamp(header) for header in headers])
    return stamps if np.isfinite(stamps).all() and len(np.unique(stamps)) > 1 else None


def _stamp(header: Any) -> float:
    """Return when a frame was taken; NaN where its header does not tell."""
    date = str(header.get('DATE-OBS', '')).strip().rstrip('Z')
    if 'T' not in date and 'TIME-OBS' in header:
        date = f'{date}T{str(header["TIME-OBS"]).strip()}'
    moment: np.datetime64
    try:
        moment = np.datetime64(date, 'ns')
    except ValueError:
        # Before 1999 dates were written in another way.
        moment = np.datetime64('NaT', 'ns')
    if not np.isnat(moment):
        return 1e-9 * float(moment.astype(np.int64))
    try:
        return 86400 * (float(header.get('MJD-OBS', 'nan')) - _MJD_1970)
    except (TypeError, ValueError):
        return math.nan


def _plane(unit: Any, index: int) -> NDArray:
    """Return one frame of a unit, NaN where it is blank."""
    place = np.unravel_index(index, unit.shape[:-2]) if unit.shape[:-2] else ()
    # Read before: it is taken from the header of what is scaled.
    blank, zero = unit.header.get('BLANK'), unit.header.get('BZERO', 0)
    # Sections apply BSCALE and BZERO to what is read alone.
    where = (*map(int, place), slice(None), slice(None))
    plane = np.asarray(unit.section[where])
    plane = np.array(plane, plane.dtype.newbyteorder('='))
    if blank is not None and plane.dtype.kind in 'iu':
        # Of unsigned numbers the library leaves blank ones as they are.
        missing = plane == blank + zero
        plane = plane.astype(np.result_type(plane.dtype, np.float32))
        plane[missing] = np.nan
    return plane


class _FitsSource:
    """Reads one plane of a cube, or one image, per frame."""

    def __init__(self, path: Path, file: Any, units: list[Any]) -> None:
        self._path = path
        self._file = file
        self._units = units

    def read(self, index: int) -> NDArray:
        with read_errors(f'frame {index} of {self._path} cannot be read', IMAGE_ERRORS):
            if len(self._units) > 1:
                return _plane(self._units[index], 0)
            return _plane(self._units[0], index)

    def close(self) -> None:
        self._file.close()


def _read_unit(path: Path, unit: int) -> NDArray:
    """Return the image of one unit of a file."""
    file = _opened(path)
    try:
        with read_errors(f'{path} cannot be read', IMAGE_ERRORS):
            return _plane(file[unit], 0)
    finally:
        file.close()
