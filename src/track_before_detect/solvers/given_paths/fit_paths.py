"""Amplitudes of a given set of paths: the group lasso over all of them, with a certificate."""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.sparse.csgraph import connected_components

from track_before_detect.checks import as_array, checked_frames, checked_number
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.kernels.fit import given_paths as cell_kernels
from track_before_detect.kernels.fit import group_lasso
from track_before_detect.models.measurement.psf import GaussianPsf, of_unit_norm
from track_before_detect.solvers.given_paths import admm
from track_before_detect.types import Step

AMPLITUDES = ('non-negative', 'signed', 'complex')

# Frames, weights and lambda up to which squares and their sums stay finite.
LARGEST = 1e70

MOST_ROUNDS = 200
# How the working set is solved, and in how many rounds at most.
METHODS = {
    'newton': (group_lasso.solve, 200),
    'descent': (group_lasso.descend, 50000),
    'admm': (admm.solve, 20000),
}
# Slots of the table that finds equal positions, as a power of two; sparse tables are fast.
LEAST_TABLE_BITS = 16
# New members of the working set in one round at least, and those looked at to choose them.
FEWEST_NEW = 16
CANDIDATES_PER_NEW = 20
# Mean overlap from which two new members count as the same for the moment.
ALIKE = 0.95
# Members without amplitude are dropped below this share of their bound, in the first rounds.
NEARLY = 0.97
MOST_PRUNED_ROUNDS = 50
# Share of its bound from which the statistic of a path is watched in every round.
FOCUS = 0.95
# Members up to which it does not pay to look for those that never meet.
SOLVED_AT_ONCE = 100
# Share of the gap over all paths, and of the gap asked for, that the working set is solved to.
INNER_SHARE = 0.02
FINAL_SHARE = 0.3


@dataclass(frozen=True)
class FittedPaths:
    """Amplitudes of given paths.

    Attributes
    ----------
    amplitudes : array, shape (P, T)
        Of the unit-norm stamps; complex for complex amplitudes.
    objective : float
        F_t, with half the energy of the residual.
    gap : float
        Duality gap over all paths, absolute: the objective is above the smallest possible one by
        no more than this. NaN at t < 1, where the objective is not convex.
    status : str
        ``"converged"`` or ``"iteration_limit"``.
    violation : float
        Largest statistic of any path on the residual over lambda, less t.
    history : list of Step
        One entry for each search of all paths.
    """

    amplitudes: NDArray
    objective: float
    gap: float
    status: str = 'converged'
    violation: float = float('nan')
    history: list[Step] = field(default_factory=list)


def fit_paths(frames: NDArray, paths: NDArray, *, psf: NDArray | GaussianPsf, lam: float,
              t: float = 1.0, amplitudes: str = 'non-negative', tol: float = 1e-8,
              weights: NDArray | None = None, method: str = 'newton') -> FittedPaths:
    """Fit the amplitudes of given paths jointly.

    Minimises, over the amplitudes x of the P paths,

        F_t(x) = 1/2 |y - A x|^2 + t lam sum_p |W_p x_p| + 1/2 (1 - t)^2 lam^2 n(x)

    with one norm over the frames of each path, W_p a positive diagonal matrix, the identity unless
    ``weights`` are given, and n(x) the number of paths with an
    amplitude other than zero. At t = 1 this is a group lasso, solved to a duality gap over all
    paths of at most ``tol`` times the objective. At t < 1 the last term makes the objective
    combinatorial; the paths are then taken as the set that is wanted: the convex part alone is
    minimised, paths are left out only where its shrinkage sets them to zero, and the last term is
    added to the objective that is returned. At t = 0 this is a least-squares fit.

    Parameters
    ----------
    frames : array, shape (T, H, W)
        Frames of unit noise (E|n|^2 = 1 where complex). Pixels that are not finite are masked;
        some have to be finite.
    paths : array, shape (P, T, 2)
        Column x and row y of each path in each frame, in pixels, inside the frame. Positions are
        taken to 1e-12 px.
    psf : array or GaussianPsf
        What a target looks like: a model, or a 2-D array with odd sides and the position of the
        target in its middle. Between the pixels a model is evaluated exactly, an array is
        interpolated bilinearly. The stamps are cut at the border and the mask and scaled to unit
        norm; one that keeps less than 1e-6 of its energy counts as none, with amplitude zero.
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
        |W^-1 h| passes t lam, and then x_k = h_k / (1 + t lam w_k^2 / |W x|) in frame k.
        The data are measured as without weights. The option ``variance`` of the detector, which
        has the same condition at t = 1, measures them by w^-2 as well: there x_k =
        h_k (1 - t lam / |W^-1 h|), the same where all w_k are. Frames divided by w, and the
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
    problem = _Problem(data, valid, paths, psf)
    if weights is not None:
        problem.weights = _checked_weights(weights, paths.shape[:2])
    non_negative = amplitudes == 'non-negative'
    if t == 0.0:
        return _least_squares(problem, lam, non_negative)
    return _WorkingSet(problem, lam, t, non_negative).run(tol, method)


def _checked_weights(weights, shape):
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


def _checked_frames(frames, amplitudes):
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


def _checked_paths(paths, shape):
    n_frames, height, width = shape
    paths = as_array('paths', paths)
    if paths.dtype.kind not in 'iuf':
        raise DataError(f'paths must be real numbers, got an array of {paths.dtype}')
    if paths.ndim != 3 or paths.shape[1:] != (n_frames, 2):
        raise DataError(f'paths must have the shape (P, {n_frames}, 2) for {n_frames} frames, '
                        f'got the shape {paths.shape}')
    paths = np.ascontiguousarray(paths, np.float64)
    outside = cell_kernels.find_outside(paths, height, width)
    if outside >= 0:
        path, frame = divmod(outside, n_frames)
        x, y = paths[path, frame].tolist()
        raise DataError(f'path {path} must be inside the frame of {width} x {height} pixels, got '
                        f'x = {x:g}, y = {y:g} in frame {frame}')
    return paths


def _checked_psf(psf):
    array = np.asarray(psf)
    if array.dtype.kind not in 'biuf':
        raise ParameterError('psf must be a GaussianPsf or an array of real numbers, got '
                             f'{type(psf).__name__}')
    return of_unit_norm(array)


def _numbered(paths):
    """Return the place of each path in each frame, (P, T), and the keys of the places."""
    bits, enough = LEAST_TABLE_BITS, 2 * paths.shape[0] * paths.shape[1]
    while True:
        places, keys, fits = cell_kernels.number_places(paths, bits)
        if fits:
            return places, keys
        bits = min(bits + 3, enough.bit_length())


class _Problem:
    """Data, and the stamps of all paths with every position rendered once."""

    def __init__(self, data, valid, paths, psf):
        self.data = data
        self.energy = 0.5 * float(np.vdot(data, data))
        self.weights = None
        height, width = data.shape[2:]
        if not isinstance(psf, GaussianPsf):
            psf = _checked_psf(psf)
        places, keys = _numbered(paths)
        self.cells, self.cell_place, self.cell_frame = cell_kernels.number_cells(places, len(keys))
        if isinstance(psf, GaussianPsf):
            self.stamps, self.origins = cell_kernels.render_gaussians(
                keys, float(psf.sigma_px), psf.integrated, psf.half_width, height, width)
        else:
            self.stamps, self.origins = cell_kernels.render_array(keys, psf, height, width)
        if valid is not None:
            self.stamps, self.origins = cell_kernels.mask_stamps(
                self.stamps, self.origins, self.cell_place, self.cell_frame, valid)
            self.cell_place = np.arange(len(self.cell_place), dtype=np.int32)
        self.starts = cell_kernels.first_pixels(self.cell_place, self.cell_frame, self.origins,
                                                height, width)

    @property
    def n_paths(self):
        return len(self.cells)

    def seen(self, residual, chosen, out):
        cell_kernels.correlate_cells(chosen, self.stamps, self.starts, self.cell_place, residual,
                                    out)

    def price(self, chosen, seen, non_negative, statistics):
        if self.weights is None:
            return cell_kernels.price(chosen, self.cells, seen, non_negative, statistics)
        return cell_kernels.price_weighted(chosen, self.cells, seen, self.weights, non_negative,
                                           statistics)

    def places(self, members):
        return self.cell_place[self.cells[members]].astype(np.int64)

    def residual(self, members, amplitudes):
        residual = self.data.copy()
        cell_kernels.subtract(members, amplitudes, self.cells, self.stamps, self.origins,
                             self.cell_place, residual)
        return residual


def _as_given(problem, members, rows):
    """Return amplitudes (P, T) of all paths from those of some, (n, D, T)."""
    n_parts, n_frames = rows.shape[1:]
    result = np.zeros((problem.n_paths, n_frames), complex if n_parts == 2 else float)
    result[members] = rows[:, 0] + 1j * rows[:, 1] if n_parts == 2 else rows[:, 0]
    return result


class _WorkingSet:
    """The few paths that have amplitudes, or were worth a try, and how they overlap."""

    def __init__(self, problem, lam, t, non_negative):
        self._problem = problem
        self._lam = lam
        self._t = t
        self._weight = t * lam
        self._non_negative = non_negative
        n_parts, n_frames = problem.data.shape[:2]
        self._members = np.empty(0, np.int64)
        self._amplitudes = np.empty((0, n_parts, n_frames))
        self._gram = np.empty((0, 0, n_frames))
        n_cells = len(problem.cell_place)
        # Paths that are priced in every round, and the cells they use.
        self._all_paths = np.arange(problem.n_paths)
        self._all_cells = np.arange(n_cells)
        self._near = self._all_paths
        self._cells = self._all_cells
        self._seen = np.zeros((n_parts, n_cells))
        self._statistics = np.zeros(problem.n_paths)

    def run(self, tol, method='newton'):
        """Solve the convex part to a relative duality gap and return the fit."""
        problem, weight = self._problem, self._weight
        history = []
        status = 'iteration_limit'
        residual = problem.data
        before, grew = math.inf, True
        for round_ in range(MOST_ROUNDS):
            if round_:
                residual = problem.residual(self._members, self._unweighted())
            norms = np.sqrt(np.einsum('pdt,pdt->p', self._amplitudes, self._amplitudes))
            convex, gap, largest = self._price(residual, norms)
            if round_ == 0:
                data_seen, self._seen = self._seen, np.empty_like(self._seen)
            done = gap <= tol * convex
            stuck = not grew and gap >= before
            if (done or stuck or round_ == MOST_ROUNDS - 1) and not self._all_priced:
                self._look_at(self._all_paths, self._all_cells)
                convex, gap, largest = self._price(residual, norms)
                done = gap <= tol * convex
            n_active = int(np.count_nonzero(norms))
            objective = convex + 0.5 * (1 - self._t)**2 * self._lam**2 * n_active
            violation = largest / self._lam - self._t
            history.append(Step(self._t, objective, n_active, violation))
            if done:
                status = 'converged'
                break
            if round_ < MOST_PRUNED_ROUNDS:
                self._keep(np.flatnonzero(
                    (norms > 0) | (self._statistics[self._members] > NEARLY * weight)))
            grew = self._grow()
            if stuck and not grew and self._all_priced:
                break
            if self._all_priced:
                self._focus()
            before = gap
            # Solving a small set to the last digit before it is complete would be in vain.
            wanted = max(INNER_SHARE * gap, FINAL_SHARE * tol * convex) if grew else 0.1 * gap
            matched = np.ascontiguousarray(
                data_seen[:, problem.cells[self._members]].transpose(1, 0, 2))
            if problem.weights is not None:
                matched /= problem.weights[self._members][:, None]
            self._solve(matched, wanted, method)
        return FittedPaths(_as_given(problem, self._members, self._unweighted()), objective,
                           gap if self._t == 1.0 else float('nan'), status, violation, history)

    def _unweighted(self):
        if self._problem.weights is None:
            return self._amplitudes
        return self._amplitudes / self._problem.weights[self._members][:, None]

    def _solve(self, matched, wanted, method):
        """Solve over the members to a duality gap; paths that never meet are solved apart."""
        if len(matched) <= SOLVED_AT_ONCE:
            self._solve_members(slice(None), matched, self._gram, wanted, method)
            return
        n_clusters, labels = connected_components(self._gram.any(axis=2), directed=False)
        for cluster in range(n_clusters):
            rows = np.flatnonzero(labels == cluster)
            self._solve_members(rows, matched[rows], self._gram[np.ix_(rows, rows)],
                                wanted / n_clusters, method)

    def _solve_members(self, rows, matched, gram, wanted, method):
        amplitudes = self._amplitudes[rows]
        solve, most_rounds = METHODS[method]
        solve(amplitudes, matched, gram, np.empty_like(matched), self._weight,
              self._non_negative, self._problem.energy, wanted, most_rounds)
        self._amplitudes[rows] = amplitudes

    @property
    def _all_priced(self):
        return len(self._near) == self._problem.n_paths

    def _price(self, residual, norms):
        """Return the convex objective, its gap and the largest statistic of the paths priced."""
        problem, weight = self._problem, self._weight
        problem.seen(residual, self._cells, self._seen)
        largest = problem.price(self._near, self._seen, self._non_negative, self._statistics)
        energy = float(np.vdot(residual, residual))
        convex = 0.5 * energy + weight * float(norms.sum())
        dual = group_lasso.dual_value(float(np.vdot(problem.data, residual)), energy, largest,
                                      weight)
        return convex, max(convex - dual, 0.0), largest

    def _focus(self):
        """Price only the paths near their bound until these are solved: it is most of the time.

        Before the end all paths are priced again, so nothing is lost by a wrong guess.
        """
        near = self._statistics > FOCUS * self._weight
        near[self._members] = True
        paths = np.flatnonzero(near)
        self._look_at(paths, cell_kernels.cells_of(paths, self._problem.cells,
                                                  len(self._all_cells)))

    def _look_at(self, paths, cells):
        self._near = paths
        self._cells = cells

    def _keep(self, rows):
        """Drop all other members."""
        if len(rows) < len(self._members):
            self._members = self._members[rows]
            self._amplitudes = self._amplitudes[rows]
            self._gram = self._gram[np.ix_(rows, rows)]

    def _grow(self):
        """Add the paths that violate their bound most; True when there were any."""
        problem = self._problem
        violates = self._statistics > self._weight
        violates[self._members] = False
        violating = self._near[violates[self._near]]
        if not len(violating):
            return False
        most = max(FEWEST_NEW, len(self._members))
        order = np.argsort(-self._statistics[violating])[:CANDIDATES_PER_NEW * most]
        candidates = violating[order]
        new = candidates[cell_kernels.pick(problem.places(candidates), most, ALIKE,
                                          problem.stamps, problem.origins)]
        n_old = len(self._members)
        n_all = n_old + len(new)
        gram = np.empty((n_all, n_all, self._gram.shape[2]))
        gram[:n_old, :n_old] = self._gram
        self._members = np.concatenate([self._members, new])
        cell_kernels.relate(problem.places(self._members), n_old, problem.stamps, problem.origins,
                           gram)
        if problem.weights is not None:
            # Columns over their weights, whose amplitudes are W x, have the one weight t lam.
            weights = problem.weights[self._members]
            gram[n_old:] /= weights[n_old:, None] * weights
            gram[:n_old, n_old:] /= weights[:n_old, None] * weights[n_old:]
        self._gram = gram
        self._amplitudes = np.concatenate(
            [self._amplitudes, np.zeros((len(new), *self._amplitudes.shape[1:]))])
        return True


def _least_squares(problem, lam, non_negative):
    """Fit without shrinkage, frame by frame: no norm joins the frames at t = 0."""
    n_parts, n_frames = problem.data.shape[:2]
    rows = np.zeros((problem.n_paths, n_parts, n_frames))
    size_y, size_x = problem.stamps.shape[1:]
    steps_y, steps_x = np.mgrid[:size_y, :size_x]
    width = problem.data.shape[3]
    for k in range(n_frames):
        # One column for all paths that meet in a place, whose amplitude they share.
        cells, column = np.unique(problem.cells[:, k], return_inverse=True)
        places = problem.cell_place[cells]
        if not len(places):
            continue
        origins = problem.origins[places]
        pixels = ((origins[:, 1, None, None] + steps_y) * width
                  + origins[:, 0, None, None] + steps_x)
        touched, row = np.unique(pixels, return_inverse=True)
        matrix = np.zeros((len(touched), len(places)))
        matrix[row.reshape(len(places), -1),
               np.arange(len(places))[:, None]] = problem.stamps[places].reshape(len(places), -1)
        target = problem.data[:, k].reshape(n_parts, -1)[:, touched].T
        if non_negative:
            fitted = nnls(matrix, target[:, 0])[0][:, None]
        else:
            fitted = np.linalg.lstsq(matrix, target, rcond=None)[0]
        shared = np.bincount(column.ravel())
        fitted[~problem.stamps[places].any(axis=(1, 2))] = 0.0
        rows[:, :, k] = (fitted / shared[:, None])[column.ravel()]
    residual = problem.residual(np.arange(problem.n_paths), rows)
    seen = np.zeros((n_parts, len(problem.cell_place)))
    problem.seen(residual, np.arange(seen.shape[1]), seen)
    largest = problem.price(np.arange(problem.n_paths), seen, non_negative,
                            np.zeros(problem.n_paths))
    n_active = int(np.count_nonzero(rows.any(axis=(1, 2))))
    objective = 0.5 * float(np.vdot(residual, residual)) + 0.5 * lam**2 * n_active
    step = Step(0.0, objective, n_active, largest / lam)
    return FittedPaths(_as_given(problem, np.arange(problem.n_paths), rows), objective,
                       float('nan'), 'converged', step.violation, [step])
