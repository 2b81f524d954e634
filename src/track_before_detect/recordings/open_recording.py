"""Open a recording of any supported kind."""

from collections.abc import Iterable
import glob
import os
from pathlib import Path

from track_before_detect.errors import DataError
from track_before_detect.recordings.images import (
    IMAGE_SUFFIXES,
    natural_key,
    open_image_folder,
)
from track_before_detect.recordings.npz import open_npy, open_npz
from track_before_detect.recordings.pictures.fits import is_fits, open_fits
from track_before_detect.recordings.pictures.tiff import open_tiff, TIFF_SUFFIXES
from track_before_detect.recordings.read_errors import closed_on_error, gathered_warnings
from track_before_detect.recordings.recording import Recording
from track_before_detect.recordings.rosbag import (
    BAG_SUFFIXES,
    find_bag,
    open_rosbag,
    PACKED_BAG_SUFFIXES,
)
from track_before_detect.recordings.video import open_video, VIDEO_SUFFIXES
from track_before_detect.recordings.zarr_store import is_zarr, open_zarr

SUPPORTED = ('.npz or .npy, a folder of images or FITS files, multi-page .tif, .fits, a video '
             '(.mp4, .avi, .mkv, .mov), Zarr (a folder, or .zip), or a bag (a folder, .db3, '
             '.mcap, or .bag of ROS 1)')


def open_recording(path: str | os.PathLike, topic: str | None = None,
                   fps: float | None = None) -> Recording:
    """Open a recording; frames are read when asked for.

    Parameters
    ----------
    path : path
        ``.npz`` with ``frames`` (T, H, W) and optionally ``stamps`` or ``fps``, and ``truth``;
        ``.npy`` with frames alone; a folder of images or FITS files; a multi-page TIFF; a FITS
        file with a cube or an image for each frame; a video file; Zarr, a folder or a ``.zip``,
        with an array (T, H, W) or a group that holds what a ``.npz`` does; a rosbag2 folder or
        storage file; a ``.bag`` of ROS 1.
    topic : str, optional
        Topic of a bag; may be left out when only one topic is suitable.
    fps : float, optional
        Frames per second, in place of the stamps that the input has or has not.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        When the input cannot be used.
    MissingExtraError
        When the package that reads this kind is not installed.
    """
    with gathered_warnings() as odd:
        try:
            recording = _opened(Path(path), topic)
        except DataError as error:
            if not odd:
                raise
            raise DataError(f'{error} ({odd[0]})') from error
    if odd:
        recording.remarks.append(f'{recording.name} is damaged or unusual: {odd[0]}')
    if fps is not None:
        with closed_on_error(recording):
            recording.set_rate(fps)
    return recording


def expand_inputs(inputs: Iterable[str | os.PathLike]) -> list[Path]:
    """Return the paths that are named, patterns such as ``day/*.npz`` expanded, each once.

    What a pattern fits comes in natural order; DataError where that is nothing.
    """
    paths: dict[Path, Path] = {}
    for given in map(Path, inputs):
        fitting = [given]
        if not given.exists() and glob.has_magic(str(given)):
            fitting = sorted(map(Path, glob.glob(str(given), recursive=True)), key=natural_key)
            if not fitting:
                raise DataError(f'no file fits {given}')
        for path in fitting:
            paths.setdefault(path.resolve(), path)
    return list(paths.values())


def _opened(path: Path, topic: str | None) -> Recording:
    if not path.exists():
        raise DataError(f'{path} does not exist')
    suffix = path.suffix.lower()
    try:
        if topic is None and is_zarr(path):
            return open_zarr(path)
        bag = find_bag(path) if path.is_dir() else path if suffix in BAG_SUFFIXES else None
        if topic is not None and bag is None:
            raise DataError(f'only a bag has topics; {path} is none')
        if bag is not None:
            return open_rosbag(bag, topic)
        if path.is_dir():
            return open_image_folder(path)
        if suffix == '.npz':
            return open_npz(path)
        if suffix == '.npy':
            return open_npy(path)
        if suffix in TIFF_SUFFIXES:
            return open_tiff(path)
        if is_fits(path):
            return open_fits(path)
        if suffix in VIDEO_SUFFIXES:
            return open_video(path)
    except PermissionError as error:
        raise DataError(f'{path} may not be read: {error.strerror}') from error
    if suffix in IMAGE_SUFFIXES:
        raise DataError(f'{path} is a single image; give the folder that holds all frames')
    if path.name.lower().endswith(PACKED_BAG_SUFFIXES):
        raise DataError(f'{path} is packed; zstd -d {path} unpacks it')
    raise DataError(f'{path} is of an unknown kind; expected {SUPPORTED}')
