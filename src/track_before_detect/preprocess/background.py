"""What does not move: estimated as a median over time and taken off."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.preprocess.resampling import warped, warped_frames
from track_before_detect.preprocess.robust import robust_deviation

_LEAST_SHARE = 1 / 3  # of the frames must show a pixel, or nothing is known about it
_MOST_PIXELS = 20_000  # of a frame that tell its gain
_CLEAR = 6.0  # errors by which a gain is another
_LEAST_EXCESS = 0.1  # of the noise that the scene must leave with the wrong gain
_OUTLYING = 3.0  # deviations beyond which a pixel has no say
_ROUNDS = 3


def temporal_median(frames: NDArray) -> NDArray:
    """Return the median over time of each pixel.

    A target that stays on a pixel for half of the frames or longer becomes part of the
    background there: it is weakened, or gone, and leaves a hole where it was absent.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real pixel values; those that are not finite are left out.

    Returns
    -------
    array, shape (H, W)
        The median, NaN where fewer than a third of the frames that show anything are finite.
    """
    return _sorted_median(np.moveaxis(frames[_shown(frames)], 0, -1), _LEAST_SHARE)


def _sorted_median(values: NDArray, least_share: float = 0.0) -> NDArray:
    """Return the median over the last axis, NaN where too small a share is finite."""
    ordered = np.array(values, order='C')
    ordered[~np.isfinite(ordered)] = np.nan
    # NaN sorts behind every number
    ordered.sort(axis=-1)
    size = ordered.shape[-1]
    count = size - np.isnan(ordered).sum(axis=-1)
    if np.all(count == size):
        return 0.5 * (ordered[..., (size - 1) // 2] + ordered[..., size // 2])
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)
    high = np.take_along_axis(ordered, count[..., None] // 2, axis=-1)
    median = 0.5 * (low + high)[..., 0]
    median[count < max(least_share * size, 1)] = np.nan
    return median


def remove_temporal_median(frames: NDArray, maps: NDArray) -> NDArray:
    """Take the background off registered frames.

    The frames keep their own grid, so that their noise stays white: they are moved onto the
    registered plane only to find the background, which is then moved back to each of them. The
    level of each frame is taken off as well, and its gain followed where it clearly jumped.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames, NaN where masked.
    maps : array, shape (T, 3, 3)
        Takes the registered plane to each frame.

    Returns
    -------
    array, shape (T, H, W)
        Frames without background, NaN where masked or where the background is not known.
    """
    aligned = warped_frames(frames, maps)
    numbers = _shown(aligned)
    reference = aligned[numbers[len(numbers) // 2] if len(numbers) else 0]
    for frame in aligned:
        frame -= _level(frame - reference)
    background = temporal_median(aligned)
    gains = _gains(aligned, background)
    if np.any(gains != 1):
        for frame, gain in zip(aligned, gains, strict=True):
            frame -= _level(frame - gain * background)
            frame /= gain
        background = temporal_median(aligned)
    residual = np.empty_like(frames)
    back = geometry.inverse(maps)
    for index, frame in enumerate(frames):
        residual[index] = frame - gains[index] * warped(background, back[index])
        residual[index] -= _level(residual[index])
    return residual


def _gains(frames: NDArray, background: NDArray) -> NDArray[np.float32]:
    """Return the gain of each frame beside the usual one, 1 where it is not clearly another."""
    step = max(1, int(np.ceil(np.sqrt(background.size / _MOST_PIXELS))))
    scene, part = background[::step, ::step], frames[:, ::step, ::step]
    slopes, errors, noises = np.array([_slope(frame, scene) for frame in part]).T
    usual = np.nanmedian(slopes) if np.isfinite(slopes).any() else 1.0
    if not usual > 0:
        return np.ones(len(frames), dtype=np.float32)
    gains = slopes / usual
    off = np.abs(gains - 1)
    with np.errstate(invalid='ignore'):
        clear = ((off > _CLEAR * errors / usual) & (gains > 0)
                 & (off * robust_deviation(scene) > _LEAST_EXCESS * noises))
    return np.where(clear, gains, 1.0).astype(np.float32)


def _slope(frame: NDArray, scene: NDArray) -> tuple[float, float, float]:
    """Return how much of a scene (H, W) a frame shows, its error, and the deviation of the rest.

    NaN where nothing is known. The error counts what the rows disagree.
    """
    known = np.isfinite(frame) & np.isfinite(scene)
    if not known.any():
        return np.nan, np.nan, np.nan
    x = np.where(known, scene - np.median(scene[known]), 0.0).astype(np.float64)
    y = np.where(known, frame - np.median(frame[known]), 0.0).astype(np.float64)
    used, slope, noise = known, 0.0, 0.0
    for _ in range(_ROUNDS):
        power = np.sum(x[used] ** 2)
        if not power > 0:
            return np.nan, np.nan, np.nan
        slope = float(np.sum(x[used] * y[used]) / power)
        rest = np.where(known, y - slope * x, 0.0)
        noise = robust_deviation(rest[known])
        used = known & (np.abs(rest) <= _OUTLYING * noise)
    pulls = np.sum(np.where(used, x * rest, 0.0), axis=1)
    return slope, float(np.sqrt(np.sum(pulls ** 2)) / power), noise


def _shown(frames: NDArray) -> NDArray[np.intp]:
    """Return the numbers of the frames that hold any data."""
    return np.flatnonzero(np.isfinite(frames).any(axis=(1, 2)))


def remove_spatial_median(frames: NDArray, mesh_px: int) -> NDArray:
    """Take slow changes over the image off each frame.

    The median of each cell of a mesh, interpolated between the centres of the cells. Of use
    after the temporal median when the camera pans under the shading of its lens, and alone when
    targets hover.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames, NaN where masked.
    mesh_px : int
        Side of a cell in pixels; a target must cover well under half of a cell.

    Returns
    -------
    array, shape (T, H, W)
        Frames without slow changes, NaN where masked.
    """
    n_frames, height, width = frames.shape
    rows, columns = -(-height // mesh_px), -(-width // mesh_px)
    padded = np.full((n_frames, rows * mesh_px, columns * mesh_px), np.nan, dtype=frames.dtype)
    padded[:, :height, :width] = frames
    cells = padded.reshape(n_frames, rows, mesh_px, columns, mesh_px)
    cells = np.moveaxis(cells, 3, 2).reshape(n_frames, rows, columns, mesh_px * mesh_px)
    along_y, along_x = _interpolation(height, mesh_px), _interpolation(width, mesh_px)
    residual = np.empty_like(frames)
    for index, frame in enumerate(frames):
        mesh = _filled(_sorted_median(cells[index]))
        residual[index] = frame - along_y @ mesh @ along_x.T
    return residual


def _filled(mesh: NDArray) -> NDArray:
    """Return the mesh with every NaN replaced by the nearest number, or by 0 without any."""
    missing = np.isnan(mesh)
    if missing.all():
        return np.zeros_like(mesh)
    if not missing.any():
        return mesh
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return mesh[tuple(nearest)]


def _interpolation(length: int, mesh_px: int) -> NDArray[np.float32]:
    """Return the matrix, shape (length, cells), of linear interpolation between cell centres."""
    n_cells = -(-length // mesh_px)
    # the last cell may be cut by the border
    edges = np.minimum(np.arange(n_cells + 1) * mesh_px, length)
    centres = 0.5 * (edges[:-1] + edges[1:] - 1)
    columns = [np.interp(np.arange(length), centres, unit) for unit in np.eye(n_cells)]
    return np.array(columns, dtype=np.float32).T


def _level(difference: NDArray) -> np.floating:
    """Return the median of the finite values, 0 without any."""
    # a quarter of the pixels tells a median well enough
    part = difference[::2, ::2]
    finite = part[np.isfinite(part)]
    return np.median(finite) if finite.size else difference.dtype.type(0)
