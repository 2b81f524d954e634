"""How well the positions of a refined path are known: Cramér-Rao bound, and what that leaves out.

The bound is that of the smooth motion that was fitted. It knows nothing of two things: amplitudes
are estimated from the same noise, and a motion may be less smooth than the price of its turns
allowed it to be fitted. Both are added here; docs/constants/refine.md says how that was checked.
"""

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.psf.gauss_newton import best_amplitudes
from track_before_detect.kernels.psf.measurement import curvatures, evaluate, smear_curvatures
from track_before_detect.solvers.refine.smooth_motions import motions_of
from track_before_detect.solvers.refine.target_model import TargetModel

# Share of the energy of a path that is taken for the target's at least, so that the covariance of
# one that might be noise alone stays finite.
LEAST_SHARE = 0.1
# Information in any direction, per px^2, so that what no frame tells is known to be unknown.
LEAST_INFORMATION = 1e-6


def position_covariance(targets: TargetModel, frames: NDArray,
                        positions: NDArray) -> NDArray[np.float64]:
    """Return the covariance of the positions of a refined path, as if it were alone.

    Parameters
    ----------
    targets : TargetModel
        What is known of the targets of the batch.
    frames : array, shape (T, H, W)
        What is left of the frames after all other paths, in units of the noise.
    positions : array, shape (T, 2)
        x and y in pixels, NaN where the target is absent.

    Returns
    -------
    array, shape (T, 2, 2)
        Pixels squared, x before y; NaN where the target is absent, zero across frames of a single
        row or column.
    """
    whole = np.full((len(positions), 2, 2), np.nan)
    [present] = np.nonzero(np.isfinite(positions[:, 0]))
    inside = slice(int(present[0]), int(present[-1]) + 1)
    if len(present) < len(positions):
        targets, frames, positions = targets.slice(inside), frames[inside], positions[inside]
    extent = targets.measurement.limits(frames.shape[1:]) > 0
    whole[inside] = _covariance(targets, frames, positions) * np.outer(extent, extent)
    return whole


def _covariance(targets: TargetModel, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
    model = targets.amplitudes
    n_frames = len(positions)
    compiled = targets.measurement.compiled(with_curvature=True)
    seen, norms, amplitudes = np.empty((n_frames, 3)), np.empty(n_frames), np.empty(n_frames)
    frames = frames.view()
    # Compiled loops are compiled for frames that cannot be written to.
    frames.flags.writeable = False
    evaluate(compiled, positions, frames, targets.pixel_weights, model.code, seen, norms)
    energy = best_amplitudes(seen, norms, model.code, amplitudes)
    fitted, free = motions_of(targets.graph, targets.times).families_around(positions)
    # Of complex noise each part has half the variance.
    variance = 0.5 if model.is_complex else 1.0
    # What noise alone adds to the energy through every number that is fitted.
    noise = variance * (model.n_numbers(n_frames) + fitted.shape[2])
    share = max(1 - noise / max(energy, 1e-300), LEAST_SHARE)
    information = amplitudes[:, None, None]**2 * _curvature(targets, compiled, positions)
    # The statistic falls off by as much as the target's own share of the energy; its slope is as
    # uncertain as all of it.
    normal = _normal(free, information)
    known, known_if_free = (
        _covariances(basis, information * share**2 / variance) for basis in (fitted, free))
    # Where the motion would go if it were free; what of that is more than noise is the weight that
    # it is.
    slope = np.einsum('ti,tib->b', amplitudes[:, None] * seen[:, 1:], free)
    step = np.linalg.solve(normal, slope)
    excess = max(float(slope @ step) / variance, 1e-300)
    weight = max(1 - (free.shape[2] - fitted.shape[2]) / excess, 0.0)
    moved = free @ step / share
    known_if_free += moved[:, :, None] * moved[:, None, :]
    return (1 - weight) * known + weight * known_if_free


def _curvature(targets: TargetModel, compiled: tuple, positions: NDArray) -> NDArray[np.float64]:
    """Return the information of a frame in which the amplitude is one, shape (T, 2, 2)."""
    along, cross = np.empty((len(positions), 2)), np.zeros(len(positions))
    curvatures(compiled, positions, along)
    if not len(targets.measurement.compiled().maps) and compiled[0][0].exposure > 0.0:
        smear_curvatures(compiled[0][0], positions, along, cross)
    matrices = np.zeros((len(positions), 2, 2))
    matrices[:, [0, 1], [0, 1]] = along
    matrices[:, 0, 1] = matrices[:, 1, 0] = cross
    return matrices


def _normal(basis: NDArray, information: NDArray) -> NDArray[np.float64]:
    normal = np.einsum('tib,tij,tjc->bc', basis, information, basis, optimize=True)
    return normal + LEAST_INFORMATION * np.eye(len(normal))


def _covariances(basis: NDArray, information: NDArray) -> NDArray[np.float64]:
    """Return the covariance (T, 2, 2) of motions of a basis (T, 2, B)."""
    return np.einsum('tib,bc,tjc->tij', basis, np.linalg.inv(_normal(basis, information)), basis,
                     optimize=True)
