"""Recordings made of images: folders, multi-page TIFF, FITS cubes."""

from __future__ import annotations

from pathlib import Path
import re
import struct
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError, MissingExtraError
from track_before_detect.recordings.encodings import luminance
from track_before_detect.recordings.read_errors import closed_on_error, read_errors
from track_before_detect.recordings.recording import Recording

TIFF_SUFFIXES = ('.tif', '.tiff')
IMAGE_SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', *TIFF_SUFFIXES)
FITS_SUFFIXES = ('.fits', '.fit', '.fts')
# What damaged files raise in the image libraries.
_READ_ERRORS = (OSError, EOFError, ValueError, TypeError, IndexError, KeyError, SyntaxError,
                RuntimeError, struct.error)
_GREY_PILLOW_MODES = ('L', 'I', 'F', 'I;16', 'I;16L', 'I;16B', 'I;16N')


def open_image_folder(path: Path) -> Recording:
    """Open a folder in which every image is a frame, in natural order of their names."""
    files = images_in(path)
    if not files:
        raise DataError(
            f'folder {path} holds neither images ({", ".join(IMAGE_SUFFIXES)}) nor a rosbag2')
    source = _FolderSource(files)
    first = source.read(0)
    return Recording(path.resolve().name, first.shape, first.dtype, len(files), source)


def images_in(folder: Path) -> list[Path]:
    """Return the images in a folder, in natural order of their names, without hidden ones."""
    return sorted((file for file in folder.iterdir()
                   if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith('.')),
                  key=natural_key)


def natural_key(file: Path) -> tuple[list[tuple[int, str]], str]:
    """Return a sort key in which 9.png comes before 10.png."""
    parts = re.split(r'([0-9]+)', file.name.lower())
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts], file.name


class _FolderSource:
    """Reads one file per frame."""

    def __init__(self, files: list[Path]) -> None:
        self._files = files

    def read(self, index: int) -> NDArray:
        return read_image(self._files[index])

    def close(self) -> None:
        pass


def read_image(file: Path) -> NDArray:
    """Return the pixels of one image, shape (H, W), colour as luminance."""
    try:
        n_bytes = file.stat().st_size
    except FileNotFoundError as error:
        # A link that leads nowhere, or a file removed since the folder was listed.
        raise DataError(f'image {file} cannot be read: {error.strerror}') from error
    if n_bytes == 0:
        raise DataError(f'image {file} is empty')
    read = _read_tiff_image if file.suffix.lower() in TIFF_SUFFIXES else _read_pillow_image
    return read(file)


def _read_pillow_image(file: Path) -> NDArray:
    try:
        from PIL import Image
    except ImportError as error:
        raise _missing('Pillow', 'images') from error
    with read_errors(f'image {file} cannot be read', _READ_ERRORS), Image.open(file) as image:
        if image.mode in ('1', 'LA', 'La'):
            return np.array(image.convert('L'))
        if image.mode in _GREY_PILLOW_MODES:
            pixels = np.array(image)
            return pixels.astype(pixels.dtype.newbyteorder('='), copy=False)
        return luminance(np.asarray(image.convert('RGB')))


def _read_tiff_image(file: Path) -> NDArray:
    tifffile = _import_tifffile()
    with (read_errors(f'image {file} cannot be read', (*_READ_ERRORS, tifffile.TiffFileError)),
          tifffile.TiffFile(file) as tiff):
        return _page_frame(file, tiff.pages[0])


def _page_frame(path: Path, page: Any) -> NDArray:
    """Return one page of a TIFF file as a frame."""
    pixels = page.asarray()
    if page.axes == 'YX':
        return pixels.astype(pixels.dtype.newbyteorder('='), copy=False)
    if page.axes == 'SYX':
        pixels = np.moveaxis(pixels, 0, -1)
    if page.axes in ('YXS', 'SYX') and pixels.shape[-1] in (3, 4):
        return luminance(pixels)
    if page.axes in ('YXS', 'SYX') and pixels.shape[-1] == 2:
        return np.ascontiguousarray(pixels[..., 0])
    raise DataError(
        f'a page of {path} must be grey or colour (H, W), got axes {page.axes} of shape '
        f'{pixels.shape}')


def open_tiff(path: Path) -> Recording:
    """Open a TIFF file in which every page is a frame."""
    tifffile = _import_tifffile()
    errors = (*_READ_ERRORS, tifffile.TiffFileError)
    with read_errors(f'{path} is not a complete TIFF file', errors):
        tiff = tifffile.TiffFile(path)
    with closed_on_error(tiff), read_errors(f'{path} cannot be read', errors):
        return _open_tiff(path, tiff, tifffile)


def _open_tiff(path: Path, tiff: Any, tifffile: ModuleType) -> Recording:
    n_pages = len(tiff.pages)
    if n_pages == 0:
        raise DataError(f'{path} holds no pages')
    if n_pages == 1:
        series = tiff.series[0]
        # Large ImageJ stacks declare a single page and append the other frames.
        if len(series.shape) == 3 and 'S' not in series.axes:
            volume = tifffile.memmap(path, mode='r')
            return Recording(path.name, volume.shape[1:], volume.dtype, len(volume),
                             _VolumeSource(volume, tiff))
        raise DataError(
            f'{path} holds a single image; a recording needs one page per frame, or a folder of '
            'images')
    source = _TiffSource(path, tiff, tifffile)
    first = source.read(0)
    return Recording(path.name, first.shape, first.dtype, n_pages, source)


class _TiffSource:
    """Reads one page per frame."""

    def __init__(self, path: Path, tiff: Any, tifffile: ModuleType) -> None:
        self._path = path
        self._tiff = tiff
        self._errors = (*_READ_ERRORS, tifffile.TiffFileError)

    def read(self, index: int) -> NDArray:
        with read_errors(f'page {index} of {self._path} cannot be read', self._errors):
            return _page_frame(self._path, self._tiff.pages[index])

    def close(self) -> None:
        self._tiff.close()


class _VolumeSource:
    """Copies frames out of an array in a mapped file."""

    def __init__(self, volume: NDArray, file: Any) -> None:
        self._volume = volume
        self._file = file

    def read(self, index: int) -> NDArray:
        return np.array(self._volume[index], self._volume.dtype.newbyteorder('='))

    def close(self) -> None:
        self._file.close()


def open_fits(path: Path) -> Recording:
    """Open the first image extension with three axes of a FITS file."""
    try:
        from astropy.io import fits
    except ImportError as error:
        raise _missing('astropy', 'FITS files') from error
    if path.stat().st_size == 0:
        raise DataError(f'{path} is empty')
    with read_errors(f'{path} is not a FITS file', _READ_ERRORS):
        # Sections are read from the file by themselves; scaled ones could not be mapped.
        units = fits.open(path, memmap=False)
    with closed_on_error(units), read_errors(f'{path} cannot be read', _READ_ERRORS):
        found = []
        for unit in units:
            shape: tuple[int, ...] = unit.shape if unit.is_image else ()
            if len(shape) == 3:
                source = _FitsSource(path, units, unit)
                first = source.read(0) if shape[0] else np.zeros(shape[1:])
                return Recording(path.name, first.shape, first.dtype, shape[0], source)
            if shape:
                found.append('x'.join(map(str, shape)))
        raise DataError(
            f'{path} must hold an image of three axes (T, H, W), found '
            f'{", ".join(found) or "no image"}')


class _FitsSource:
    """Reads one plane of a cube per frame."""

    def __init__(self, path: Path, units: Any, unit: Any) -> None:
        self._path = path
        self._units = units
        self._unit = unit

    def read(self, index: int) -> NDArray:
        with read_errors(f'frame {index} of {self._path} cannot be read', _READ_ERRORS):
            # Sections apply BSCALE and BZERO to what is read alone.
            plane = np.asarray(self._unit.section[index, :, :])
        return np.array(plane, plane.dtype.newbyteorder('='))

    def close(self) -> None:
        self._units.close()


def _import_tifffile() -> ModuleType:
    try:
        import tifffile
    except ImportError as error:
        raise _missing('tifffile', 'TIFF files') from error
    return tifffile


def _missing(package: str, what: str) -> MissingExtraError:
    return MissingExtraError(
        f"reading {what} needs {package}: pip install 'track_before_detect[readers]'")
