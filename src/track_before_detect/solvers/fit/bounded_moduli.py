"""The convex problem of constant moduli and free phases, by an interior-point method.

    minimise 1/2 x'Gx - h'x + sum of w_p s_p   over   |x_pk| <= s_p c_pk

Descent path by path takes thousands of sweeps where paths are nearly alike; Newton steps on this
problem with the barrier -tau sum of log(s_p^2 c_pk^2 - |x_pk|^2) take some tens, whatever the
overlap. Frames meet in the bounds s alone, so each step solves one small system for each frame and
one of as many unknowns as there are paths.
"""

import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit.constant_modulus import convex_gap
from track_before_detect.models.amplitudes import ComplexConstant

MOST_STEPS = 300
# By how much the barrier is lowered once a step gains less than this share of its height.
LOWER = 0.1
CENTRED = 0.3
# Share of the way to the bounds that a step may go, and of the fall it promises that it must keep.
TO_THE_BOUND = 0.99
LEAST_FALL = 0.1
MOST_HALVINGS = 30


def solve(matched: NDArray, gram: NDArray, envelopes: NDArray, penalties: NDArray, energy: float,
          gap_wanted: float) -> tuple[NDArray, float]:
    """Minimise to a duality gap.

    Parameters
    ----------
    matched, gram, envelopes, penalties, energy
        As of ``fit_amplitudes``: h, G, c (zero in frames that show nothing of a path), w > 0.
    gap_wanted : float
        Duality gap to reach.

    Returns
    -------
    amplitudes : complex array, shape (P, T)
        Zero for paths that are not used.
    gap : float
        Duality gap reached.
    """
    problem = _Problem(matched, gram, envelopes, penalties, energy)
    n_bounds = max(int(np.count_nonzero(envelopes)), 1)
    x = np.zeros((2, *matched.shape))
    s = np.full(len(penalties), math.sqrt(2 * energy))
    # Each bound is worth twice the height of the barrier.
    height = energy / n_bounds
    best, gap = np.zeros(matched.shape, complex), math.inf
    for _ in range(MOST_STEPS):
        x, s, gain = problem.step(x, s, height)
        if gain > CENTRED * height:
            continue
        reached, amplitudes = problem.certified(x, s)
        if reached < gap:
            best, gap = amplitudes, reached
        if gap <= gap_wanted or height * n_bounds < 1e-3 * gap_wanted:
            break
        height *= LOWER
    return best, gap


class _Problem:
    """Values and steps; x has the shape (2, P, T), the real and the imaginary parts."""

    def __init__(self, matched: NDArray, gram: NDArray, envelopes: NDArray,
                 penalties: NDArray, energy: float):
        self._data = matched
        self._matched = np.array([matched.real, matched.imag])
        self._gram = gram
        self._envelopes = envelopes
        self._squares = envelopes**2
        self._penalties = penalties
        self._energy = energy

    def _room(self, x: NDArray, s: NDArray) -> NDArray:
        """Return s^2 c^2 - |x|^2, one where nothing is seen."""
        return np.where(self._squares > 0, s[:, None]**2 * self._squares - (x**2).sum(axis=0), 1)

    def _value(self, x: NDArray, s: NDArray, height: float) -> float:
        explained = np.einsum('pqt,dqt->dpt', self._gram, x)
        return (np.vdot(x, 0.5 * explained - self._matched) + self._penalties @ s
                - height * np.log(self._room(x, s)).sum())

    def step(self, x: NDArray, s: NDArray, height: float) -> tuple[NDArray, NDArray, float]:
        """Return x and s after a Newton step, and half the squared Newton decrement."""
        n_paths, n_frames = self._envelopes.shape
        room, squares = self._room(x, s), self._squares
        slope_x = np.einsum('pqt,dqt->dpt', self._gram, x) - self._matched + 2 * height * x / room
        slope_s = self._penalties - 2 * height * s * (squares / room).sum(axis=1)
        # Second derivatives: a matrix of 2 P unknowns for each frame, what joins it to s, and the
        # diagonal of s.
        joint = np.zeros((n_frames, 2, n_paths, 2, n_paths))
        path = np.arange(n_paths)
        for d in range(2):
            joint[:, d, :, d] = self._gram.transpose(2, 0, 1)
            joint[:, d, path, d, path] += 2 * height * (1 / room).T
            for e in range(2):
                joint[:, d, path, e, path] += 4 * height * (x[d] * x[e] / room**2).T
        size = 2 * n_paths
        to_s = np.zeros((n_frames, size, n_paths))
        for d in range(2):
            slopes = s[:, None] * squares * x[d] / room**2
            to_s[:, d * n_paths + path, path] = -4 * height * slopes.T
        of_s = 2 * height * (squares * (s[:, None]**2 * squares + (x**2).sum(axis=0))
                             / room**2).sum(axis=1)
        right = slope_x.transpose(2, 0, 1).reshape(n_frames, size, 1)
        solved = np.linalg.solve(joint.reshape(n_frames, size, size),
                                 np.concatenate([to_s, right], axis=2))
        reduced = np.diag(of_s) - np.einsum('tap,taq->pq', to_s, solved[..., :-1])
        step_s = np.linalg.solve(
            reduced, np.einsum('tap,ta->p', to_s, solved[..., -1]) - slope_s)
        step_x = -(solved[..., -1] + solved[..., :-1] @ step_s)
        step_x = step_x.reshape(n_frames, 2, n_paths).transpose(1, 2, 0)
        gain = -0.5 * float(np.vdot(slope_x, step_x) + slope_s @ step_s)
        before, share = self._value(x, s, height), 1.0
        for _ in range(MOST_HALVINGS):
            moved_x, moved_s = x + share * step_x, s + share * step_s
            if (moved_s > 0).all() and (self._room(moved_x, moved_s)
                                        > (1 - TO_THE_BOUND) * room).all():
                if self._value(moved_x, moved_s, height) <= (
                        before - 2 * LEAST_FALL * share * gain + 1e-14 * self._energy):
                    return moved_x, moved_s, gain
            share *= 0.5
        return x, s, 0.0

    def certified(self, x: NDArray, s: NDArray) -> tuple[float, NDArray]:
        """Return the duality gap, and amplitudes zero for paths that the solution does not use.

        Towards it either the bound of a path goes to zero or what its statistic lacks of its
        penalty does.
        """
        lacking = 1 - (self._envelopes * np.abs(self._left(x))).sum(axis=1) / self._penalties
        x = np.where((lacking > s / s.sum())[:, None], 0.0, x)
        amplitudes = x[0] + 1j * x[1]
        norms = ComplexConstant().norms(amplitudes, self._envelopes)
        _, gap = convex_gap(amplitudes, norms, self._data, self._left(x), self._envelopes,
                            self._penalties, self._energy)
        return gap, amplitudes

    def _left(self, x: NDArray) -> NDArray:
        """Return h - G x, complex."""
        return self._data - np.einsum('pqt,qt->pt', self._gram, x[0] + 1j * x[1])
