"""Positions between the grid for targets that enter or leave: refined with their interval."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel, SIGNED_CONSTANT
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.refine.refinement import Refiner

# Rounds of positions for an interval and interval for the positions; each gains.
MOST_ROUNDS = 3
# Frames at either end whose mean velocity carries a path on beyond it.
FRAMES_OF_VELOCITY = 5


class PartialRefiner(Refiner):
    """Moves one path to the positions and frames where it explains most.

    Parameters
    ----------
    graph, psf, stamps, weights, model
        As for Refiner.
    presence : Presence
        Cost of being present.
    """

    def __init__(self, graph: StateGraph, psf: Psf | MultiSensor, stamps: NDArray,
                 weights: NDArray, model: AmplitudeModel, presence: Presence):
        super().__init__(graph, psf, stamps, weights, model)
        self._graph = graph
        self._psf = psf
        self._stamps = stamps
        self._presence = presence
        self._refiners: dict[tuple[int, int], Refiner] = {}

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float]:
        """Return better positions and their cost, or those given when none is better.

        Positions are NaN where the target is absent; see :meth:`Refiner.refine`.
        """
        n_frames = len(frames)
        best = (self._lowers(frames, positions, cost, threshold, t_convex), positions, cost)
        present = np.flatnonzero(np.isfinite(positions[:, 0]))
        interval: tuple[int, int] = (int(present[0]), int(present[-1]))
        turns = cost - self._presence.cost(*interval, n_frames)
        moved = positions
        for _ in range(MOST_ROUNDS):
            first, last = interval
            inside = slice(first, last + 1)
            price = self._presence.cost(first, last, n_frames)
            stretch = self._stretch(first, last)
            cost_scale = stretch * self._cost_scale(frames[inside], moved[inside])
            weight = self._model.weight(threshold, price * cost_scale)
            part, turns = self._refiner(first, last).refine(
                frames[inside], moved[inside], turns * stretch, weight, t_convex)
            turns /= stretch
            whole = self._carried_on(part, first, last)
            interval = self._best_interval(frames, whole, interval)
            moved = np.full_like(whole, np.nan)
            moved[interval[0]:interval[1] + 1] = whole[interval[0]:interval[1] + 1]
            moved_cost = turns + self._presence.cost(*interval, n_frames)
            gain = self._lowers(frames, moved, moved_cost, threshold, t_convex)
            if gain > best[0]:
                best = (gain, moved, moved_cost)
            if interval == (first, last):
                break
        return best[1], best[2]

    def value(self, frames: NDArray, positions: NDArray, cost: float) -> float:
        """Return the value of a path: what it adds up over its frames less its cost."""
        seen, norms = self._seen(frames, positions)
        statistic = self._model.statistic(seen, self._model.envelope(norms))
        return self._model.value(statistic) - cost * self._model.cost_scale(norms)

    def _best_interval(self, frames, positions, now):
        """Return the first and last frame in which a path on ``positions`` gains most."""
        seen, norms = self._seen(frames, positions)
        if not self._model.is_constant:
            envelope = self._model.envelope(norms)
            return self._presence.best_interval(self._model.best(seen, envelope)**2)
        products = norms * seen
        if self._model.code == SIGNED_CONSTANT:
            products = products * np.sign(products[now[0]:now[1] + 1].sum())
        return self._presence.best_constant_interval(
            np.where(norms > 0, products, -np.inf), norms**2)

    def _stretch(self, first, last):
        """Return by how much more a cost counts in these frames than in all of them."""
        if not self._model.is_constant:
            return 1.0
        return math.sqrt(len(self._stamps) / (last - first + 1))

    def _refiner(self, first, last):
        """Return the refiner for paths in these frames alone."""
        if (first, last) not in self._refiners:
            graph, inside = self._graph, slice(first, last + 1)
            knots = np.unique(np.clip(graph.knots, first, last + 1)) - first
            coupling = graph.coupling
            if coupling is not None:
                coupling = dataclasses.replace(coupling, times=coupling.times[inside])
            part = dataclasses.replace(graph, knots=knots, coupling=coupling,
                                       turn_cost=graph.turn_cost * self._stretch(first, last))
            # One row of weights may serve all frames.
            weights = self._weights[inside] if len(self._weights) > 1 else self._weights
            self._refiners[first, last] = Refiner(
                part, self._psf, self._stamps[inside], weights, self._model)
        return self._refiners[first, last]

    def _carried_on(self, part, first, last):
        """Return a path in all frames, straight on before its first and after its last."""
        stamps = self._stamps
        whole = np.empty((len(stamps), 2))
        whole[first:last + 1] = part
        for end, other, beyond in (
                (first, min(first + FRAMES_OF_VELOCITY, last), slice(0, first)),
                (last, max(last - FRAMES_OF_VELOCITY, first), slice(last + 1, None))):
            velocity = np.zeros(2)
            if other != end:
                velocity = (whole[end] - whole[other]) / (stamps[end] - stamps[other])
            whole[beyond] = whole[end] + (stamps[beyond] - stamps[end])[:, None] * velocity
        return whole

    def _seen(self, frames, positions):
        """Return h and n of each frame (T,), see AmplitudeModel; 0 where it is not in the frame.

        All n are one where all pixels weigh the same.
        """
        height, width = frames.shape[1:]
        inside = np.all((positions >= 0) & (positions <= (width - 1, height - 1)), axis=1)
        seen, norms = self._evaluate(frames, np.where(inside[:, None], positions, 0.0))
        counted = norms if len(self._weights) else np.ones(len(norms))
        return np.where(inside, seen[:, 0], 0.0), np.where(inside, counted, 0.0)

    def _lowers(self, frames, positions, cost, threshold, t_convex):
        """By how much the path lowers F_t, alone on these frames."""
        seen, norms = self._seen(frames, positions)
        statistic = self._model.statistic(seen, self._model.envelope(norms))
        return self.lowers(statistic**2, cost * self._model.cost_scale(norms), threshold, t_convex)
