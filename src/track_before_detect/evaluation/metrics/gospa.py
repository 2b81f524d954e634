"""A metric on sets of trajectories: GOSPA over time, with a price on changes of identity.

García-Fernández, Rahmathullah and Svensson, *A metric on the space of finite sets of trajectories
for evaluation of multi-target tracking algorithms*, IEEE Trans. Signal Process. 68 (2020), in the
form of a linear programme over soft assignments. Without a price on changes it is the sum over
frames of GOSPA (Rahmathullah, García-Fernández and Svensson, Fusion 2017) with alpha = 2.

The programme is solved exactly, but rarely as a whole: a pair that is never within the cutoff is
left out for good, the rest is priced by the duals of the best assignment that never changes, and
only what could improve on it enters a programme (column generation), in which runs of frames where
nothing competes count as one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linear_sum_assignment, linprog
from scipy.sparse.csgraph import connected_components

from track_before_detect.errors import DataError, ParameterError
from track_before_detect.evaluation.metrics.matching import Paths

# Relative to the gain of one perfect pair in one frame.
_TOLERANCE = 1e-7
# Prices that still rise after this many rounds are left to the programme.
_MOST_ROUNDS = 30


class TrajectoryGospa(NamedTuple):
    """Distance of two sets of trajectories, and what it is made of.

    Attributes
    ----------
    distance : float
        (localisation + missed + false + switching)^(1/order), in pixels.
    localisation, missed, false, switching : float
        Summed over all frames, in pixels to the power of the order: errors of pairs within the
        cutoff; half the cutoff's power for each frame of a target without one, and for each frame
        of a trajectory without one; changes of identity.
    """

    distance: float
    localisation: float
    missed: float
    false: float
    switching: float


def trajectory_gospa(found: Paths, targets: Paths, *, cutoff_px: float, switch_px: float,
                     order: float = 2.0) -> TrajectoryGospa:
    """Measure how far trajectories are from the targets.

    Parameters
    ----------
    found, targets : sequence of array, shape (T, 2)
        Positions in pixels; NaN where absent.
    cutoff_px : float
        Distance from which two are no pair (c of the reference), above 0.
    switch_px : float
        Price of one change of identity (its gamma), not negative; half of it for a change between
        a target and none.
    order : float
        Its p, at least 1.

    Raises
    ------
    DataError
        The trajectories do not share one number of frames.
    """
    if not cutoff_px > 0 or not switch_px >= 0 or not order >= 1:
        raise ParameterError(
            'cutoff_px must be above 0, switch_px at least 0 and order at least 1, got '
            f'{cutoff_px:g}, {switch_px:g} and {order:g}')
    estimates, truths = _stacked('found', found), _stacked('targets', targets)
    if len(estimates) and len(truths) and estimates.shape[1] != truths.shape[1]:
        raise DataError(
            f'found and targets must cover the same frames, got {estimates.shape[1]} and '
            f'{truths.shape[1]}')
    pairs = _Pairs.of(estimates, truths, cutoff_px, order)
    weights, changes = _best_weights(pairs, cutoff_px**order, 0.5 * switch_px**order)
    close = np.where(pairs.gains > 0, weights, 0.0)
    n_paired = close.sum()
    localisation = n_paired * cutoff_px**order - float((close * pairs.gains).sum())
    half = 0.5 * cutoff_px**order
    parts = (max(localisation, 0.0), half * float(_present(truths).sum() - n_paired),
             half * float(_present(estimates).sum() - n_paired),
             0.5 * switch_px**order * changes)
    return TrajectoryGospa(float(sum(parts)**(1 / order)), *map(float, parts))


class _Pairs(NamedTuple):
    """Trajectories and targets that come within the cutoff.

    Attributes
    ----------
    ends : array of int, shape (P, 2)
        Trajectory and target.
    gains : array, shape (P, T)
        What pairing the two in a frame takes off the distance; 0 where it takes off nothing.
    counts : tuple of int
        Number of trajectories and targets.
    """

    ends: NDArray[np.int64]
    gains: NDArray[np.float64]
    counts: tuple[int, int]

    @classmethod
    def of(cls, estimates: NDArray, truths: NDArray, cutoff: float, order: float) -> _Pairs:
        ends: list[tuple[int, int]] = []
        gains: list[NDArray] = []
        if not len(estimates) or not len(truths):
            return cls(np.zeros((0, 2), np.int64), np.zeros((0, 0)),
                       (len(estimates), len(truths)))
        boxes = _boxes(truths)
        for number, (estimate, (low, high)) in enumerate(
                zip(estimates, _boxes(estimates).transpose(1, 0, 2), strict=True)):
            inside = (boxes[0] <= high + cutoff) & (boxes[1] >= low - cutoff)
            candidates = np.flatnonzero(inside.all(axis=1))
            distances = np.hypot(*(truths[candidates] - estimate).transpose(2, 0, 1))
            distances[~(distances < cutoff)] = cutoff
            gain = cutoff**order - distances**order
            near = (gain > 0).any(axis=1)
            ends += [(number, target) for target in candidates[near]]
            gains.append(gain[near])
        return cls(np.array(ends, np.int64).reshape(-1, 2),
                   np.concatenate(gains),
                   (len(estimates), len(truths)))


def _stacked(name: str, trajectories: Paths) -> NDArray[np.float64]:
    """Return trajectories as one array (N, T, 2)."""
    arrays = [np.asarray(one, float) for one in trajectories]
    if any(one.ndim != 2 or one.shape != (len(arrays[0]), 2) for one in arrays):
        raise DataError(
            f'{name} must be trajectories of one shape (T, 2), got '
            f'{sorted({one.shape for one in arrays})}')
    return np.array(arrays) if arrays else np.zeros((0, 0, 2))


def _boxes(positions: NDArray) -> NDArray[np.float64]:
    """Return least and largest x and y of trajectories, shape (2, N, 2); empty for absent ones."""
    return np.array([
        np.where(np.isfinite(positions), positions, np.inf).min(axis=1, initial=np.inf),
        np.where(np.isfinite(positions), positions, -np.inf).max(axis=1, initial=-np.inf)])


def _present(positions: NDArray) -> NDArray[np.bool_]:
    return np.isfinite(positions).all(axis=2)


def _best_weights(pairs: _Pairs, full: float, half_switch: float) -> tuple[NDArray, float]:
    """Return how much of each pair holds in each frame, (P, T), and the sum of all changes.

    Column generation: ``active`` pairs share programmes with those they compete with; every other
    pair is priced against the duals of frames and trajectories.
    """
    n_pairs, n_frames = pairs.gains.shape
    weights = np.zeros((n_pairs, n_frames))
    if not n_pairs:
        return weights, 0.0
    lasting = _lasting_pairs(pairs)
    weights[lasting] = 1.0
    duals = _first_duals(pairs, lasting)
    active = np.zeros(n_pairs, bool)
    while True:
        prices = pairs.gains - duals[0][pairs.ends[:, 0]] - duals[1][pairs.ends[:, 1]]
        improving = ~active & ~lasting & (
            _best_spell(prices, half_switch) > _TOLERANCE * full)
        if not improving.any():
            return weights, float(np.abs(np.diff(weights, axis=1)).sum())
        active |= improving
        _solve(pairs, _competing(pairs, active, lasting, improving), half_switch, weights, duals)


def _lasting_pairs(pairs: _Pairs) -> NDArray[np.bool_]:
    """Return a mask of the pairs of the best assignment that never changes."""
    total = np.zeros(pairs.counts)
    total[tuple(pairs.ends.T)] = pairs.gains.sum(axis=1)
    chosen = np.zeros(pairs.counts, bool)
    chosen[linear_sum_assignment(total, maximize=True)] = True
    return chosen[tuple(pairs.ends.T)]


def _first_duals(pairs: _Pairs, lasting: NDArray[np.bool_]) -> list[NDArray]:
    """Return values of trajectories (N, T) and targets (M, T) whose sum is what is gained.

    In every frame where the lasting pairs are the best assignment, no other pair gains more than
    its two are worth: prices rise until no rival outbids them, from either side, and the middle of
    the two is taken.
    """
    ends = pairs.ends.T
    half = [_outbid(pairs, lasting, ends, side) for side in (0, 1)]
    return [0.5 * (half[0][side] + half[1][1 - side]) for side in (0, 1)]


def _outbid(pairs: _Pairs, lasting: NDArray[np.bool_], ends: NDArray,
            side: int) -> list[NDArray]:
    """Return the least values of the other side, and the most of this one, this one first."""
    n_frames = pairs.gains.shape[1]
    own, other = ends[side], ends[1 - side]
    values = [np.zeros((pairs.counts[side], n_frames)),
              np.zeros((pairs.counts[1 - side], n_frames))]
    values[0][own[lasting]] = pairs.gains[lasting]
    rivals = np.flatnonzero(~lasting)
    # In the order of what they bid for: taking the most of each run is quick.
    rivals = rivals[np.argsort(other[rivals], kind='stable')]
    wanted, starts = np.unique(other[rivals], return_index=True)
    for _ in range(_MOST_ROUNDS if len(rivals) else 0):
        bids = pairs.gains[rivals] - values[0][own[rivals]]
        raised = values[1].copy()
        raised[wanted] = np.maximum(raised[wanted], np.maximum.reduceat(bids, starts))
        # Nobody pays more than it gains; what has no partner has no price.
        ceiling = np.zeros_like(raised)
        ceiling[other[lasting]] = pairs.gains[lasting]
        raised = np.minimum(raised, ceiling)
        if np.array_equal(raised, values[1]):
            break
        values[1] = raised
        values[0][own[lasting]] = pairs.gains[lasting] - raised[other[lasting]]
    return values


def _best_spell(prices: NDArray, half_switch: float) -> NDArray[np.float64]:
    """Return the most that each pair can earn over the frames, shape (P,), at least 0."""
    off, on = np.zeros(len(prices)), prices[:, 0].copy()
    for price in prices.T[1:]:
        off, on = (np.maximum(off, on - half_switch),
                   price + np.maximum(on, off - half_switch))
    return np.maximum(off, on)


def _competing(pairs: _Pairs, active: NDArray[np.bool_], lasting: NDArray[np.bool_],
               improving: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the active and lasting pairs that compete with improving ones, however far off."""
    members = np.flatnonzero(active | lasting)
    ends = pairs.ends[members] + [0, pairs.counts[0]]
    count = sum(pairs.counts)
    graph = sparse.coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][ends[:, 0]]
    return members[np.isin(labels, labels[improving[members]])]


def _solve(pairs: _Pairs, members: NDArray[np.int64], half_switch: float, weights: NDArray,
           duals: list[NDArray]) -> None:
    """Solve the programme of some pairs; updates their weights and the duals of their ends.

    Variables are the weights, pair by pair and block by block of frames, then how much each rises
    and falls between blocks.
    """
    gains = pairs.gains[members]
    ends = pairs.ends[members] + [0, pairs.counts[0]]
    begins = _block_begins(gains > 0, ends, sum(pairs.counts))
    variable = np.cumsum(begins).reshape(begins.shape) - 1
    block_gains = np.bincount(variable.ravel(), gains.ravel())
    starts = _row_starts(begins, ends, sum(pairs.counts))
    row = np.cumsum(starts).reshape(starts.shape) - 1
    n_weights, n_rows = len(block_gains), int(row.max()) + 1
    pair, which, frame = np.nonzero(starts[ends])
    capacity = sparse.coo_array(
        (np.ones(len(pair)), (row[ends[pair, which], frame], variable[pair, frame])),
        shape=(n_rows, n_weights))
    later = np.setdiff1d(np.arange(n_weights), variable[:, 0])
    n_changes = len(later)
    differences = sparse.coo_array(
        (np.repeat([1.0, -1.0], n_changes),
         (np.tile(np.arange(n_changes), 2), np.append(later, later - 1))),
        shape=(n_changes, n_weights))
    rises = sparse.identity(n_changes)
    solution = linprog(
        np.concatenate([-block_gains, np.full(2 * n_changes, half_switch)]),
        A_ub=sparse.hstack([capacity, sparse.coo_array((n_rows, 2 * n_changes))]),
        b_ub=np.ones(n_rows),
        A_eq=sparse.hstack([differences, -rises, rises]), b_eq=np.zeros(n_changes),
        bounds=(0, None), method='highs')
    if not solution.success:
        raise DataError(f'the trajectories could not be compared: {solution.message}')
    weights[members] = np.clip(solution.x[:n_weights], 0, 1)[variable]
    # What an end is worth, shared out evenly over the frames of its row of the programme.
    values = (-solution.ineqlin.marginals / np.bincount(row.ravel()))[row]
    for side in (0, 1):
        duals[side][pairs.ends[members, side]] = values[ends[:, side]]
        # And over those of a block in which a pair gains in proportion to the gain, so that the
        # pair is not better off for a part of the block.
        worth = np.bincount(variable.ravel(), values[ends[:, side]].ravel())
        share = gains * (worth / np.maximum(block_gains, 1e-300))[variable]
        one, frame = np.nonzero(gains > 0)
        duals[side][pairs.ends[members[one], side], frame] = share[one, frame]


def _block_begins(gaining: NDArray[np.bool_], ends: NDArray, n_ends: int) -> NDArray[np.bool_]:
    """Return in which frames a pair begins a block, inside which its weight need not change.

    A block is a run of frames in which the pair gains nothing, or in which it gains and no other
    pair of its two ends does; any other frame is one for itself. Some best solution is constant in
    all of them: give each pair its least weight in the blocks where it gains nothing, which only
    makes room, and then its largest in those where it gains, for which there is room throughout.
    Neither raises the sum of its changes.
    """
    rivals = np.zeros((n_ends, gaining.shape[1]), np.int64)
    for side in (0, 1):
        np.add.at(rivals, ends[:, side], gaining)
    contested = gaining & (rivals[ends] > 1).any(axis=1)
    begins = np.ones(gaining.shape, bool)
    begins[:, 1:] = (gaining[:, 1:] != gaining[:, :-1]) | contested[:, 1:] | contested[:, :-1]
    return begins


def _row_starts(begins: NDArray[np.bool_], ends: NDArray, n_ends: int) -> NDArray[np.bool_]:
    """Return in which frames an end begins a row of the programme, shape (ends, T).

    An end has a row for each run of frames in which none of its pairs begins a block.
    """
    starts = np.zeros((n_ends, begins.shape[1]), bool)
    starts[:, 0] = True
    for side in (0, 1):
        np.logical_or.at(starts, ends[:, side], begins)
    return starts
