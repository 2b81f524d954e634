"""Simulated recordings in every format that can be written here."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import MissingExtraError
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.recordings.zarr_store import write_zarr_recording
from track_before_detect.simulation.sensor import add_target

SNR, FPS, N_TARGETS = 6.0, 25, 3
# Grey levels of the background, and of its noise.
LEVEL, SIGMA = 100, 12


def simulated(seed: int, n_frames: int, side_px: int) -> NDArray[np.uint8]:
    """Return noise with targets that go straight on, one after the other of which enters."""
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((n_frames, side_px, side_px), dtype=np.float32)
    for number in range(N_TARGETS):
        place, velocity = rng.uniform(0.2, 0.8, 2) * side_px, rng.uniform(-0.5, 0.5, 2)
        first = number * n_frames // (2 * N_TARGETS)
        for t in range(first, min(first + 2 * side_px, n_frames)):
            x, y = place + (t - first) * velocity
            add_target(frames[t], x, y, 1.0, SNR)
    return np.clip(np.rint(LEVEL + SIGMA * frames), 0, 255).astype(np.uint8)


def write_recordings(folder: Path, number: int, n_frames: int, side_px: int) -> list[Path]:
    """Write so many recordings, the formats taking turns; those without a package left out."""
    paths: list[Path] = []
    writers = list(_WRITERS.items())
    while len(paths) < number and writers:
        suffix, write = writers.pop(0)
        path = folder / f'{len(paths):03}{suffix}'
        with suppress(ImportError, MissingExtraError):
            write(path, simulated(len(paths), n_frames, side_px))
            paths.append(path)
            writers.append((suffix, write))
    return paths


def _npz(path: Path, frames: NDArray) -> None:
    write_npz_recording(path, frames, np.arange(len(frames)) / FPS)


def _zarr(path: Path, frames: NDArray) -> None:
    write_zarr_recording(path, frames, np.arange(len(frames)) / FPS)


def _images(path: Path, frames: NDArray) -> None:
    from PIL import Image
    path.mkdir()
    for number, frame in enumerate(frames):
        Image.fromarray(frame).save(path / f'{number:05}.png')


def _tiff(path: Path, frames: NDArray) -> None:
    import tifffile
    tifffile.imwrite(path, frames, photometric='minisblack')


def _fits(path: Path, frames: NDArray) -> None:
    from astropy.io import fits
    fits.PrimaryHDU(frames).writeto(path)


def _video(path: Path, frames: NDArray) -> None:
    import av
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=FPS)
        stream.height, stream.width = frames.shape[1:]
        stream.pix_fmt = 'gray'
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format='gray')))
        container.mux(stream.encode())


_WRITERS: dict[str, Callable[[Path, NDArray], None]] = {
    '.npz': _npz, '.npy': np.save, '': _images, '.tif': _tiff, '.fits': _fits, '.avi': _video,
    '.mkv': _video, '.zarr': _zarr}
