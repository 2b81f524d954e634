"""Positions between the grid: fit a smooth motion to what one path sees.

After a fit on the nearest grid positions the rest of a bright target would pass the threshold as
a ghost, so positions are refined inside the pursuit, those of a target that enters or leaves
together with the frames in which it is there.
"""

from dataclasses import replace
from functools import cached_property
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.compile_flags import read_only
from track_before_detect.kernels.fit.constant_modulus import clip_moduli
from track_before_detect.kernels.psf.gauss_newton import best_amplitudes, maximise_statistic
from track_before_detect.kernels.psf.measurement import curvatures, evaluate, smear_curvatures
from track_before_detect.solvers.refine.position_covariance import position_covariance
from track_before_detect.solvers.refine.smooth_motions import motions_of, SmoothMotions
from track_before_detect.solvers.refine.target_model import TargetModel

MOST_STEPS = 8
# Fall of F_t for which a path is moved: a tenth of the error that noise gives its position.
LEAST_GAIN = 0.005
# Rounds of positions for an interval and interval for the positions; each gains.
MOST_ROUNDS = 3
# Frames at either end whose mean velocity carries a path on beyond it.
FRAMES_OF_VELOCITY = 5


class PathRefiner(Protocol):
    """Moves one path to where it explains most."""

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float] | None:
        """Return better positions and their cost, or None when none are better.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            What is left of the frames after all other paths.
        positions : array, shape (T, 2)
            x and y in pixels, NaN where the target is absent.
        cost : float
            Cost of the given path: of its turns and of being present.
        threshold : float
            lambda of a path without any cost.
        t_convex : float
            Place on the continuation.
        """

    def value(self, frames: NDArray, positions: NDArray, cost: float) -> float:
        """Return the value of a path: what it adds up over the frames less its cost."""

    def covariance(self, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
        """Return the covariance of the positions of a path that was refined, shape (T, 2, 2).

        Pixels squared, x before y; NaN where the target is absent, zero across frames of a single
        row or column.
        """


def refiner_for(targets: TargetModel) -> PathRefiner:
    """Return the refiner of targets that are there in every frame, or in some."""
    return Refiner(targets) if targets.presence is None else PartialRefiner(targets)


class Refiner:
    """Moves one path that is there in every frame to the positions where it explains most."""

    def __init__(self, targets: TargetModel):
        self._targets = targets
        self._compiled = targets.measurement.compiled(with_curvature=True)
        self._weights = np.asarray(targets.pixel_weights, np.float32)
        self._model = targets.amplitudes

    @cached_property
    def _motions(self) -> SmoothMotions:
        return motions_of(self._targets.graph, self._targets.times)

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float] | None:
        """Return better positions and their cost, see :meth:`PathRefiner.refine`."""
        frames = read_only(frames)
        limits = self._targets.measurement.limits(frames.shape[1:])
        squared = float(self.gains(frames, positions).sum())
        price = cost * self.cost_scale(frames, positions)
        least = self._fall(frames, positions, squared, price, threshold, t_convex) + LEAST_GAIN
        best = None
        for start, basis, family_cost in self._motions.candidates(positions, cost):
            moved = np.array(start)
            value = maximise_statistic(moved, basis, self._compiled, limits, frames,
                                       self._weights, self._model.code, MOST_STEPS)
            if not self._motions.allowed(moved):
                continue
            moved_cost = family_cost
            if moved_cost is None:
                moved_cost = self._motions.cost(moved)
            moved_cost += self._motions.overspeed_cost(moved)
            price = self.cost_scale(frames, moved) * moved_cost
            gain = self._fall(frames, moved, value, price, threshold, t_convex)
            if gain > least:
                least, best = gain, (moved, moved_cost)
        return best

    def value(self, frames: NDArray, positions: NDArray, cost: float) -> float:
        """Return the value of a path: what it adds up over the frames less its cost."""
        squared = float(self.gains(frames, positions).sum())
        return self._model.value(math.sqrt(squared)) - cost * self.cost_scale(frames, positions)

    def covariance(self, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
        """Return the covariance of the positions, see :meth:`PathRefiner.covariance`."""
        n_frames, model = len(positions), self._model
        seen, norms = self._evaluate(frames, positions)
        amplitudes = np.empty(n_frames)
        best_amplitudes(seen, norms, model.code, amplitudes)
        # Of complex noise each part has half the variance.
        covariance = position_covariance(
            *self._motions.families_around(positions), self._curvature(positions), seen[:, 1:],
            amplitudes, model.n_numbers(n_frames), 0.5 if model.is_complex else 1.0)
        extent = self._targets.measurement.limits(frames.shape[1:]) > 0
        return covariance * np.outer(extent, extent)

    def _curvature(self, positions: NDArray) -> NDArray[np.float64]:
        """Return the curvature of the statistic of each frame, shape (T, 2, 2)."""
        along, cross = np.empty((len(positions), 2)), np.zeros(len(positions))
        curvatures(self._compiled, positions, along)
        if not len(self._compiled.maps) and self._compiled.optics[0].exposure > 0.0:
            smear_curvatures(self._compiled.optics[0], positions, along, cross)
        return np.stack([along[:, 0], cross, cross, along[:, 1]], axis=1).reshape(-1, 2, 2)

    def gains(self, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
        """Return what each frame adds to the squared statistic of a path, shape (T,)."""
        seen, norms = self._evaluate(frames, positions)
        amplitudes = np.empty(len(positions))
        best_amplitudes(seen, norms, self._model.code, amplitudes)
        return amplitudes**2

    def statistics(self, frames: NDArray, positions: NDArray,
                   ) -> tuple[NDArray, NDArray, NDArray[np.bool_]]:
        """Return h and n of each frame, see ``amplitudes``, and whether a target may be there.

        Both are zero where it may not, beyond the borders, or where its frame does not show it;
        all other n are one where all pixels weigh the same. Each of shape (T,).
        """
        limits = self._targets.measurement.limits(frames.shape[1:])
        inside = np.all((positions >= 0) & (positions <= limits), axis=1)
        seen, norms = self._evaluate(frames, positions)
        return np.where(inside, seen[:, 0], 0.0), np.where(inside, norms, 0.0), inside

    def cost_scale(self, frames: NDArray, positions: NDArray) -> float:
        """Return by how much more the turns of a path cost, see AmplitudeModel."""
        if not self._model.is_constant:
            return 1.0
        if not len(self._weights) and not len(self._compiled.maps):
            # All n are one.
            return 1.0
        return self._model.cost_scale(self._evaluate(frames, positions)[1])

    def _evaluate(self, frames: NDArray, positions: NDArray) -> tuple[NDArray, NDArray]:
        seen = np.empty((len(positions), 3))
        norms = np.empty(len(positions))
        evaluate(self._compiled, positions, read_only(frames), self._weights, self._model.code,
                 seen, norms)
        return seen, norms

    def _fall(self, frames: NDArray, positions: NDArray, squared: float, cost: float,
              threshold: float, t_convex: float) -> float:
        """Return by how much a path of this squared statistic lowers F_t, alone."""
        penalty = self._model.penalty(threshold, cost)
        if not (self._model.has_one_modulus and t_convex == 1.0):
            return _fall_of(math.sqrt(squared), penalty, t_convex)
        # Bounded moduli explain more than equal ones: half the squared norm of what is left of
        # them after shrinkage.
        seen, norms = self._evaluate(frames, positions)
        left = np.array(seen[:, 0])
        clip_moduli(left, self._model.envelope(norms), penalty)
        return 0.5 * float(left @ left)


class PartialRefiner:
    """Moves one path to the positions and frames where it explains most."""

    def __init__(self, targets: TargetModel):
        assert targets.presence is not None
        self._targets = targets
        self._times = targets.times
        self._model = targets.amplitudes
        self._presence = targets.presence
        self._refiners: dict[tuple[int, int], Refiner] = {}

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float] | None:
        """Return better positions and their cost, see :meth:`PathRefiner.refine`."""
        n_frames = len(frames)
        least, best = self._fall(frames, positions, cost, threshold, t_convex), None
        first, last = _ends(positions)
        turns = cost - self._presence.cost(first, last, n_frames)
        moved = positions
        for _ in range(MOST_ROUNDS):
            inside = slice(first, last + 1)
            refiner, stretch = self._refiner(first, last), self._stretch(first, last)
            price = self._presence.cost(first, last, n_frames)
            cost_scale = stretch * refiner.cost_scale(frames[inside], moved[inside])
            part, turns = refiner.refine(
                frames[inside], moved[inside], turns * stretch,
                self._model.penalty(threshold, price * cost_scale), t_convex,
            ) or (moved[inside], turns * stretch)
            turns /= stretch
            whole = self._carried_on(part, first, last)
            before = first, last
            first, last = self._best_interval(frames, whole, first, last)
            moved = np.full_like(whole, np.nan)
            moved[first:last + 1] = whole[first:last + 1]
            moved_cost = turns + self._presence.cost(first, last, n_frames)
            gain = self._fall(frames, moved, moved_cost, threshold, t_convex)
            if gain > least:
                least, best = gain, (moved, moved_cost)
            if (first, last) == before:
                break
        return best

    def value(self, frames: NDArray, positions: NDArray, cost: float) -> float:
        """Return the value of a path: what it adds up over its frames less its cost."""
        statistic, cost_scale = self._statistic(frames, positions)
        return self._model.value(statistic) - cost * cost_scale

    def covariance(self, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
        """Return the covariance of the positions, see :meth:`PathRefiner.covariance`."""
        first, last = _ends(positions)
        inside = slice(first, last + 1)
        whole = np.full((len(positions), 2, 2), np.nan)
        whole[inside] = self._refiner(first, last).covariance(frames[inside], positions[inside])
        return whole

    def _fall(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
              t_convex: float) -> float:
        """Return by how much the path lowers F_t, alone on these frames."""
        statistic, cost_scale = self._statistic(frames, positions)
        penalty = self._model.penalty(threshold, cost * cost_scale)
        return _fall_of(statistic, penalty, t_convex)

    def _statistic(self, frames: NDArray, positions: NDArray) -> tuple[float, float]:
        """Return the statistic of a path, and by how much more it costs, see AmplitudeModel."""
        first, last = _ends(positions)
        inside = slice(first, last + 1)
        seen, norms = np.zeros((2, len(frames)))
        seen[inside], norms[inside], _ = self._refiner(first, last).statistics(
            frames[inside], positions[inside])
        statistic = self._model.statistic(seen, self._model.envelope(norms))
        return statistic, self._model.cost_scale(norms)

    def _best_interval(self, frames: NDArray, positions: NDArray, first: int, last: int,
                       ) -> tuple[int, int]:
        """Return the first and last frame in which a path on ``positions`` gains most.

        At present these are ``first`` and ``last``.
        """
        seen, norms, possible = self._refiner(0, len(frames) - 1).statistics(frames, positions)
        if not self._model.is_constant:
            envelope = self._model.envelope(norms)
            return self._presence.best_interval(self._model.best(seen, envelope)**2)
        products = norms * seen
        if -1 in self._model.signs:
            products = products * np.sign(products[first:last + 1].sum())
        return self._presence.best_constant_interval(
            np.where(possible, products, -np.inf), norms**2)

    def _stretch(self, first: int, last: int) -> float:
        """Return by how much more a cost counts in these frames than in all of them."""
        if not self._model.is_constant:
            return 1.0
        return math.sqrt(len(self._times) / (last - first + 1))

    def _refiner(self, first: int, last: int) -> Refiner:
        """Return the refiner for paths in these frames alone."""
        if (first, last) not in self._refiners:
            inside = self._targets.slice(slice(first, last + 1))
            graph = replace(inside.graph,
                            turn_cost=inside.graph.turn_cost * self._stretch(first, last))
            self._refiners[first, last] = Refiner(replace(inside, graph=graph))
        return self._refiners[first, last]

    def _carried_on(self, part: NDArray, first: int, last: int) -> NDArray[np.float64]:
        """Return a path in all frames, straight on before its first and after its last."""
        times = self._times
        whole = np.empty((len(times), 2))
        whole[first:last + 1] = part
        for end, other, beyond in (
                (first, min(first + FRAMES_OF_VELOCITY, last), slice(0, first)),
                (last, max(last - FRAMES_OF_VELOCITY, first), slice(last + 1, None))):
            velocity = np.zeros(2)
            # Frames of several sensors may share a moment.
            if times[other] != times[end]:
                velocity = (whole[end] - whole[other]) / (times[end] - times[other])
            whole[beyond] = whole[end] + (times[beyond] - times[end])[:, None] * velocity
        return whole


def _fall_of(statistic: float, penalty: float, t_convex: float) -> float:
    """Return by how much a path lowers F_t, alone."""
    excess = statistic - t_convex * penalty
    return 0.5 * max(excess, 0.0)**2 - 0.5 * (1 - t_convex)**2 * penalty**2


def _ends(positions: NDArray) -> tuple[int, int]:
    """Return the first and the last frame in which a path is present."""
    [present] = np.nonzero(np.isfinite(positions[:, 0]))
    return int(present[0]), int(present[-1])
