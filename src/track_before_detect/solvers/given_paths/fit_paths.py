"""Amplitudes of a given set of paths: the group lasso over all of them, with a certificate."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from track_before_detect.checks import as_array, checked_frames, checked_number
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.kernels.fit import given_paths as kernels
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.solvers.given_paths import least_squares
from track_before_detect.solvers.given_paths.problem import FittedPaths, Problem
from track_before_detect.solvers.given_paths.working_set import METHODS, WorkingSet

AMPLITUDES = ('non-negative', 'signed', 'complex')

# Frames, weights and lambda up to which squares and their sums stay finite.
LARGEST = 1e70


def fit_paths(frames: NDArray, paths: NDArray, *, psf: ArrayLike | GaussianPsf | ArrayPsf,
              lam: float, t: float = 1.0, amplitudes: str = 'non-negative',
              tol: float = 1e-8, weights: NDArray | None = None,
              method: str = 'newton') -> FittedPaths:
    """Fit the amplitudes of given paths jointly.

    Minimises, over the amplitudes x of the P paths, ::

        F_t(x) = 1/2 |y - A x|^2 + t lam sum_p |W_p x_p| + 1/2 (1 - t)^2 lam^2 n(x)

    with one norm over the frames of each path, W_p a positive diagonal matrix, the identity unless
    ``weights`` are given, and n(x) the number of paths with an amplitude other than zero. At t = 1
    this is a group lasso, solved to a duality gap over all paths of at most ``tol`` times the
    objective. At t < 1 the last term makes the objective combinatorial; the paths are then taken
    as the set that is wanted: the convex part alone is minimised, paths are left out only where
    its shrinkage sets them to zero, and the last term is added to the objective that is returned.
    At t = 0 this is a least-squares fit.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Frames of unit noise (E|n|^2 = 1 where complex). Pixels that are not finite are masked;
        some have to be finite.
    paths : array, shape (P, T, 2)
        Column x and row y of each path in each frame, in pixels, inside the frame. Positions are
        taken to 1e-12 px.
    psf : array, GaussianPsf or ArrayPsf
        What a target looks like: a Gaussian, or a 2-D array with odd sides and the position of
        the target in its middle, as it is or as an ``ArrayPsf``. A Gaussian is evaluated exactly,
        an array between its pixels by cubic splines, as in the detectors. The stamps are cut at
        the border and the mask and scaled to unit norm; as in the detectors, one that keeps no
        more than 1e-3 of its energy counts as none, with amplitude zero.
    lam : float
        Weight of each path: the threshold on its statistic.
    t : float
        Place on the continuation, 1 (convex) to 0 (combinatorial).
    amplitudes : str
        ``"non-negative"``, ``"signed"`` or ``"complex"``.
    tol : float
        Duality gap at which to stop, over the objective.
    weights : array, shape (T,) or (P, T), optional
        Diagonal of W: a lone path with matched filter statistic h has a norm above zero only if
        ``|W^-1 h|`` passes t lam, and then ``x_k = h_k / (1 + t lam w_k^2 / |W x|)``.
        The data are measured as without weights. The option ``variance`` of the detector, which
        has the same condition at t = 1, measures them by w^-2 as well: there x_k =
        ``h_k (1 - t lam / |W^-1 h|)``, the same where all w_k are. Frames divided by w, and the
        amplitudes multiplied by it, give that here.
    method : str
        How the paths of the working set are solved: ``"newton"``, sweeps of path-wise descent and
        Newton steps; ``"descent"``, sweeps alone (Patent, Algorithm 3), with the closed form of
        Algorithm 2 where weights are equal and the line search of Algorithm 1 where not;
        ``"admm"``, alternating directions. All reach the same optimum; the last two take far
        longer where paths are nearly alike.

    Returns
    -------
    FittedPaths

    Notes
    -----
    The time grows with the cube of the number of paths that have amplitudes and overlap, directly
    or through others: milliseconds for tens, tens of seconds for a thousand, as when a small
    ``t * lam`` lets the paths fit the noise.
    """
    data, valid = _checked_frames(frames, amplitudes)
    paths = _checked_paths(paths, data.shape[1:])
    lam = checked_number('lam', lam, above=0.0, maximum=LARGEST)
    t = checked_number('t', t, minimum=0.0, maximum=1.0)
    tol = checked_number('tol', tol, above=0.0)
    if method not in METHODS:
        raise ParameterError(f'method must be one of {", ".join(METHODS)}, got {method!r}')
    model = psf if isinstance(psf, (GaussianPsf, ArrayPsf)) else _checked_psf(psf)
    diagonals = None if weights is None else _checked_weights(weights, paths.shape[:2])
    problem = Problem(data, valid, paths, model, diagonals, amplitudes == 'non-negative')
    if t == 0.0:
        return least_squares.fit(problem, lam)
    return WorkingSet(problem, lam, t).run(tol, method)


def _checked_weights(weights: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = as_array('weights', weights)
    if array.dtype.kind not in 'biuf' or array.shape not in (shape, shape[1:]):
        raise DataError(f'weights must be numbers of shape ({shape[1]},) or {shape}, got '
                        f'{array.dtype} of shape {array.shape}')
    array = np.ascontiguousarray(np.broadcast_to(array, shape), np.float64)
    if not (np.isfinite(array).all() and (array > 0).all()):
        raise DataError('weights must be finite and above 0, got '
                        f'{array[~(np.isfinite(array) & (array > 0))][0]:g}')
    if len(array) and not (array.min() >= 1 / LARGEST and array.max() <= LARGEST):
        raise DataError(f'weights must be from {1 / LARGEST:g} to {LARGEST:g}, got '
                        f'{array.min():g} to {array.max():g}')
    return array


def _checked_frames(frames: ArrayLike, amplitudes: str) -> tuple[NDArray, NDArray | None]:
    """Return the frames as (D, T, H, W), masked pixels zero, and what is valid (or None)."""
    if amplitudes not in AMPLITUDES:
        raise ParameterError(
            f'amplitudes must be one of {", ".join(AMPLITUDES)}, got {amplitudes!r}')
    frames = checked_frames(frames)
    if frames.dtype.kind == 'c' and amplitudes != 'complex':
        raise DataError(f'complex frames need amplitudes complex, got {amplitudes!r}')
    valid = np.isfinite(frames)
    if not valid.any():
        raise DataError(f'no pixel of the {len(frames)} frames is finite')
    size = float(np.abs(frames, where=valid, out=np.zeros(frames.shape)).max())
    if size > LARGEST:
        raise DataError(f'frames must hold values of at most {LARGEST:g}, got {size:g}')
    parts = (frames.real, frames.imag) if amplitudes == 'complex' else (frames,)
    data = np.array(parts, np.float64)
    if valid.all():
        return data, None
    data[:, ~valid] = 0.0
    return data, valid


def _checked_paths(paths: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    n_frames, height, width = shape
    paths = as_array('paths', paths)
    if paths.dtype.kind not in 'iuf':
        raise DataError(f'paths must be real numbers, got an array of {paths.dtype}')
    if paths.ndim != 3 or paths.shape[1:] != (n_frames, 2):
        raise DataError(f'paths must have the shape (P, {n_frames}, 2) for {n_frames} frames, '
                        f'got the shape {paths.shape}')
    paths = np.ascontiguousarray(paths, np.float64)
    outside = kernels.find_outside(paths, height, width)
    if outside >= 0:
        path, frame = divmod(outside, n_frames)
        x, y = paths[path, frame].tolist()
        raise DataError(f'path {path} must be inside the frame of {width} x {height} pixels, got '
                        f'x = {x:g}, y = {y:g} in frame {frame}')
    return paths


def _checked_psf(psf: ArrayLike) -> ArrayPsf:
    array = np.asarray(psf)
    if array.dtype.kind not in 'biuf':
        raise ParameterError('psf must be an array of real numbers, a track_before_detect.'
                             f'GaussianPsf or an ArrayPsf, got {type(psf).__name__}')
    return ArrayPsf(array)
