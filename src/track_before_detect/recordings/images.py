"""Recordings made of images: folders in which each file is a frame."""

from collections.abc import Iterable
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import DataError
from track_before_detect.recordings.pictures.fits import is_fits, open_fits_series
from track_before_detect.recordings.pictures.pillow import read_pillow_image
from track_before_detect.recordings.pictures.series import FileSeries
from track_before_detect.recordings.pictures.tiff import read_tiff_image, TIFF_SUFFIXES
from track_before_detect.recordings.recording import Recording

IMAGE_SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', *TIFF_SUFFIXES)
_MASK_NAME = re.compile(r'(.+)[ ._-](mask|gt|label|seg|truth)s?')


def open_image_folder(path: Path) -> Recording:
    """Open a folder in which every image is a frame, in natural order of their names.

    FITS files are frames where there are no images. Files named like another one and _mask are
    left out.
    """
    files = images_in(path)
    if not files:
        series = _in_order(file for file in path.iterdir() if is_fits(file))
        if series:
            return open_fits_series(path, series)
        raise DataError(
            f'folder {path} holds neither images ({", ".join(IMAGE_SUFFIXES)}) nor FITS files nor '
            'a rosbag2')
    masks = _masks_among(files)
    files = [file for file in files if file not in masks]
    source = FileSeries(
        lambda index: read_image(files[index]),
        lambda index: f'frame {index} of {path}, {files[index].name},', _like)
    first = source.read(0)
    recording = Recording(path.resolve().name, first.shape, first.dtype, len(files), source)
    if masks:
        recording.remarks.append(
            f'{len(masks)} images of {recording.name} are left out as masks of others: '
            f'{", ".join(sorted(file.name for file in masks)[:3])}'
            f'{", …" if len(masks) > 3 else ""}')
    return recording


def images_in(folder: Path) -> list[Path]:
    """Return the images in a folder, in natural order of their names, without hidden ones."""
    return _in_order(file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)


def natural_key(file: Path) -> tuple[list[tuple[int, str]], str]:
    """Return a sort key in which 9.png comes before 10.png."""
    parts = re.split(r'([0-9]+)', file.name.lower())
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts], file.name


def _in_order(files: Iterable[Path]) -> list[Path]:
    return sorted((file for file in files if not file.name.startswith('.')), key=natural_key)


def _masks_among(files: list[Path]) -> set[Path]:
    """Return the files that are named as the mask of another one."""
    stems = {file.stem.lower() for file in files}
    named = {file: _MASK_NAME.fullmatch(file.stem.lower()) for file in files}
    return {file for file, match in named.items() if match is not None and match[1] in stems}


def _like(frame: NDArray, first: NDArray) -> NDArray:
    """Return a frame in grey or colour of 8 bits as the type of the other, where it fits."""
    if {frame.dtype, first.dtype} != {np.dtype(np.uint8), np.dtype(np.float32)}:
        return frame
    converted = np.rint(frame).astype(first.dtype)
    # Luminance of equal channels is off by the rounding of its weights.
    return converted if np.allclose(converted, frame, rtol=1e-6) else frame


def read_image(file: Path) -> NDArray:
    """Return the pixels of one image, shape (H, W), colour as luminance."""
    try:
        n_bytes = file.stat().st_size
    except FileNotFoundError as error:
        # A link that leads nowhere, or a file removed since the folder was listed.
        raise DataError(f'image {file} cannot be read: {error.strerror}') from error
    if n_bytes == 0:
        raise DataError(f'image {file} is empty')
    read = read_tiff_image if file.suffix.lower() in TIFF_SUFFIXES else read_pillow_image
    return read(file)
