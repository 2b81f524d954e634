"""Amplitudes of a few paths that overlap, at any t and for any amplitude model."""

import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit import constant_modulus, group_lasso, least_squares
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.solvers.fit import bounded_moduli
from track_before_detect.solvers.watch import Watch

MOST_ROUNDS = 200
# Sweeps over amplitudes of constant modulus: at t = 1 another method takes over from there.
MOST_SWEEPS, SWEEPS_AT_FIRST = 2000, 300
# A Newton step of more paths takes seconds and cannot be left: where the time is limited they are
# fitted by sweeps, so many between two looks at the watch, and so often at most.
MOST_FOR_NEWTON = 150
SWEEPS_AT_A_TIME, MOST_LOOKS = 20, 100
# Share of the energy of the data below which a duality gap is lost in rounding, and that to which
# moduli are bounded.
ROUNDING = 1e-12
MODULI_ROUNDING = 1e-10


def fit_amplitudes(amplitudes: NDArray, matched: NDArray, gram: NDArray, penalties: NDArray,
                   t_convex: float, model: AmplitudeModel, energy: float,
                   gap: float, envelopes: NDArray | None = None,
                   watch: Watch | None = None) -> tuple[NDArray, bool]:
    """Minimise 1/2 x'Gx - h'x + t sum w_p |x_p| over the amplitudes x of given paths.

    Moduli that are constant are held so at t < 1, where they end at a stationary point that is no
    worse than the start; at t = 1 they are bounded instead, with the norm that the amplitude model
    has for it, and the problem is convex.

    Parameters
    ----------
    amplitudes : array, shape (P, T)
        Where to start.
    matched : array, shape (P, T)
        Inner products h of the stamps with the data.
    gram : array, shape (P, P, T)
        Inner products of the stamps of two paths in one frame.
    penalties : array, shape (P,)
        lambda of each path.
    t_convex : float
        t, from 1 (convex) to 0 (combinatorial).
    model : AmplitudeModel
        What amplitudes may be.
    energy : float
        Half the squared norm of the data.
    gap : float
        Duality gap to reach where t > 0; at t = 0 the optimum is reached to rounding.
    envelopes : array, shape (P, T), optional
        Of constant amplitudes: how they are in proportion, of unit norm; all equal unless given.
    watch : Watch, optional
        Says when the time is up: many paths are then left as they are.

    Returns
    -------
    amplitudes : array, shape (P, T)
    converged : bool
    """
    constant = model.is_constant
    if envelopes is None:
        envelopes = np.full(amplitudes.shape, 1 / math.sqrt(amplitudes.shape[1]))
    if model.has_one_modulus:
        return _fit_moduli(amplitudes, matched, gram, envelopes, penalties, t_convex, energy,
                           max(gap, MODULI_ROUNDING * energy))
    if constant:
        # One amplitude for each path: its column joins all frames.
        x = np.sum(envelopes * amplitudes, axis=1, keepdims=True)
        matched = np.sum(envelopes * matched, axis=1, keepdims=True)
        gram = np.einsum('pt,pqt,qt->pq', envelopes, gram, envelopes)[:, :, None]
    else:
        x = amplitudes.copy()
    non_negative = model.non_negative
    # As (P, D, T): a complex number is D = 2 real ones.
    x, matched = _in_parts(x), _in_parts(matched)
    if t_convex == 0.0:
        converged = least_squares.solve(x, matched, np.ascontiguousarray(gram), non_negative)
    else:
        # Columns over their penalties have the one penalty t.
        x *= penalties[:, None, None]
        wanted = max(gap, ROUNDING * energy)
        problem = (matched / penalties[:, None, None],
                   gram / (penalties[:, None] * penalties)[:, :, None], np.empty_like(x), t_convex,
                   non_negative, energy, wanted)
        if watch is None or not watch.is_limited or len(x) <= MOST_FOR_NEWTON:
            reached, _ = group_lasso.solve(x, *problem, MOST_ROUNDS)
        else:
            for _ in range(MOST_LOOKS):
                reached, _ = group_lasso.descend(x, *problem, SWEEPS_AT_A_TIME)
                if reached <= wanted or watch.time_is_up():
                    break
        converged = reached <= wanted
        x /= penalties[:, None, None]
    fitted = x[:, 0] + 1j * x[:, 1] if model.is_complex else x[:, 0]
    return envelopes * fitted if constant else fitted, converged


def _fit_moduli(amplitudes: NDArray, matched: NDArray, gram: NDArray, envelopes: NDArray,
                penalties: NDArray, t_convex: float, energy: float, wanted: float,
                ) -> tuple[NDArray, bool]:
    """Fit amplitudes of constant modulus and free phase."""
    x = np.array(amplitudes, complex)
    matched = np.ascontiguousarray(matched, complex)
    gram, envelopes = np.ascontiguousarray(gram), np.ascontiguousarray(envelopes)
    convex = t_convex == 1.0
    left = constant_modulus.descend(
        x, np.empty(len(x)), matched, gram, envelopes, t_convex * penalties, convex, energy,
        wanted, SWEEPS_AT_FIRST if convex else MOST_SWEEPS)
    if convex and left > wanted:
        x, left = bounded_moduli.solve(matched, gram, envelopes, penalties, energy, wanted)
    return x, left <= wanted


def _in_parts(values: NDArray) -> NDArray[np.float64]:
    """Return a copy of values (P, T) as real numbers, shape (P, 1, T) or (P, 2, T)."""
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    return np.ascontiguousarray(np.stack(parts, axis=1), np.float64)


def objective(amplitudes: NDArray, matched: NDArray, gram: NDArray, penalties: NDArray,
              t_convex: float, norms: NDArray | None = None) -> float:
    """Return F_t without the energy of the data.

    F_t = 1/2 x'Gx - h'x + t sum w_p |x_p| + 1/2 (1 - t)^2 sum of w_p^2 over paths with x_p != 0

    Parameters
    ----------
    amplitudes, matched, gram, penalties, t_convex
        As in :func:`fit_amplitudes`.
    norms : array, shape (P,), optional
        |x_p| of each path where it is not the Euclidean norm.
    """
    explained = np.einsum('pqt,qt->pt', gram, amplitudes)
    if norms is None:
        norms = np.linalg.norm(amplitudes, axis=1)
    return float(np.vdot(amplitudes, 0.5 * explained - matched).real
                 + t_convex * np.sum(penalties * norms)
                 + 0.5 * (1 - t_convex)**2 * np.sum(penalties[norms > 0]**2))
