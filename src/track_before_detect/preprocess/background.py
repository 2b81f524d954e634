"""What does not move: estimated as a median over time and taken off."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.kernels.pictures.median_over_time import median_over_time
from track_before_detect.preprocess.per_frame import each_frame, shown
from track_before_detect.preprocess.resampling import warped, warped_frames
from track_before_detect.preprocess.robust import median, robust_deviation

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
    with_data = shown(frames)
    return _median_over_first(frames if with_data.all() else frames[with_data], _LEAST_SHARE)


def _median_over_first(values: NDArray, least_share: float = 0.0) -> NDArray:
    """Return the median over the first axis, NaN where too small a share is finite."""
    size = len(values)
    middle = np.empty(values.shape[1:], values.dtype)
    median_over_time(np.ascontiguousarray(values).reshape(size, middle.size),
                     max(least_share * size, 1.0), middle.reshape(-1))
    return middle


def remove_temporal_median(frames: NDArray, maps: NDArray) -> NDArray:
    """Take the background off registered frames.

    The frames keep their own grid, so that their noise stays white: they are moved onto the
    registered plane only to find the background, which is then moved back to each of them. The
    level of each frame is taken off as well, and its gain followed where it clearly jumped.

    Parameters
    ----------
    frames, maps : arrays, shapes (T, H, W) and (T, 3, 3)
        Real frames, NaN where masked, and what takes the registered plane to each of them.

    Returns
    -------
    array, shape (T, H, W)
        Frames without background, NaN where masked or where the background is not known.
    """
    residual = warped_frames(frames, maps)
    numbers = np.flatnonzero(shown(residual))
    reference = _part(residual[numbers[len(numbers) // 2] if len(numbers) else 0])

    def bring_to_one_level(frame: NDArray) -> None:
        frame -= _level(_part(frame) - reference)

    def bring_to_one_gain(frame: NDArray, gain: np.floating) -> None:
        frame -= _level(_part(frame) - gain * _part(background))
        frame /= gain

    def leave(rest: NDArray, frame: NDArray, gain: np.floating, matrix: NDArray) -> None:
        np.subtract(frame, gain * warped(background, matrix), out=rest)
        rest -= _level(_part(rest))

    each_frame(bring_to_one_level, residual)
    background = temporal_median(residual)
    gains = _gains(residual, background)
    if np.any(gains != 1):
        each_frame(bring_to_one_gain, residual, gains)
        background = temporal_median(residual)
    # The frames on the plane are done with.
    each_frame(leave, residual, frames, gains, geometry.inverse(maps))
    return residual


def remove_stripes(frames: NDArray) -> None:
    """Take off in place what columns and rows of a sensor add to all its frames.

    Where the scene moves in the frames, that stands still and is none of it.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Real frames without their scene, NaN where masked.
    """
    # A quarter of the pixels of a line tells its median well enough.
    for axis, part in ((1, frames[::2, ::2]), (2, frames[::2, :, ::2])):
        pixels = np.moveaxis(part, axis, 1).reshape(-1, part.shape[3 - axis])
        lines = _median_over_first(pixels)
        frames -= np.expand_dims(np.nan_to_num(lines), axis - 1)


def _gains(frames: NDArray, background: NDArray) -> NDArray[np.float32]:
    """Return the gain of each frame beside the usual one, 1 where it is not clearly another."""
    step = max(1, int(np.ceil(np.sqrt(background.size / _MOST_PIXELS))))
    scene, part = background[::step, ::step], frames[:, ::step, ::step]
    slopes, errors, noises = np.array(each_frame(lambda frame: _slope(frame, scene), part)).T
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
    x = np.where(known, scene - median(scene[known]), 0.0).astype(np.float64)
    y = np.where(known, frame - median(frame[known]), 0.0).astype(np.float64)
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


def without_spatial_median(frame: NDArray, mesh_px: int) -> NDArray:
    """Return a frame without slow changes over the image.

    The median of each cell of a mesh, interpolated between the centres of the cells. Of use
    after the temporal median when the camera pans under the shading of its lens, and alone when
    targets hover.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real, NaN where masked.
    mesh_px : int
        Side of a cell in pixels; a target must cover well under half of a cell.

    Returns
    -------
    array, shape (H, W)
        NaN where masked.
    """
    height, width = frame.shape
    rows, columns = -(-height // mesh_px), -(-width // mesh_px)
    padded = np.full((rows * mesh_px, columns * mesh_px), np.nan, dtype=frame.dtype)
    padded[:height, :width] = frame
    cells = padded.reshape(rows, mesh_px, columns, mesh_px).transpose(1, 3, 0, 2)
    mesh = _median_over_first(cells.reshape(mesh_px**2, rows, columns))
    mesh = with_nearest(mesh, np.isnan(mesh))
    return frame - _between_cells(_between_cells(mesh, height, mesh_px).T, width, mesh_px).T


def with_nearest(image: NDArray, missing: NDArray[np.bool_]) -> NDArray:
    """Return an image with the nearest value where one is missing, with 0 where all are."""
    if missing.all():
        return np.zeros_like(image)
    if not missing.any():
        return image
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def _between_cells(mesh: NDArray, length: int, mesh_px: int) -> NDArray:
    """Return values at cell centres (cells, N) interpolated along the first axis, (length, N)."""
    n_cells = len(mesh)
    # the last cell may be cut by the border
    edges = np.minimum(np.arange(n_cells + 1) * mesh_px, length)
    centres = 0.5 * (edges[:-1] + edges[1:] - 1)
    place = np.interp(np.arange(length), centres, np.arange(n_cells))
    below = place.astype(int)
    share = (place - below).astype(mesh.dtype)[:, None]
    # Two rows at a time, not a product of matrices: the threads of BLAS cost more than they gain.
    return mesh[below] * (1 - share) + mesh[np.minimum(below + 1, n_cells - 1)] * share


def _part(frame: NDArray) -> NDArray:
    """Return a quarter of the pixels, which tells a median well enough."""
    return frame[::2, ::2]


def _level(values: NDArray) -> np.floating:
    """Return the median of the finite values, 0 without any."""
    finite = values[np.isfinite(values)]
    return median(finite) if finite.size else values.dtype.type(0)
