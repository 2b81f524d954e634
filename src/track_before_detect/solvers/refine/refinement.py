"""Positions between the grid: fit a smooth motion to what one path sees.

After a fit on the nearest grid positions the rest of a bright target would pass the threshold as
a ghost, so positions are refined inside the pursuit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect.kernels.fit.constant_modulus import clip_moduli
from track_before_detect.kernels.psf.gauss_newton import best_amplitudes, maximise_statistic
from track_before_detect.kernels.psf.measurement import evaluate
from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import Psf
from track_before_detect.models.motion.state_graph import StateGraph
from track_before_detect.solvers.refine.smooth_motions import motions_of

MOST_STEPS = 8
# Fall of F_t for which a path is moved: a tenth of the error that noise gives its position.
LEAST_GAIN = 0.005


class Refiner:
    """Moves one path to the positions where it explains most.

    Parameters
    ----------
    graph : StateGraph
        Bounds the speed and prices the turns.
    psf : Psf or MultiSensor
        What a target looks like.
    stamps : array, shape (T,)
        In the unit of time of the graph.
    weights : float32 array, shape (T, H, W), (1, H, W) or (0, 0, 0)
        One over the noise of each pixel; of no frames where it is one.
    model : AmplitudeModel
        Of the amplitudes.
    """

    def __init__(self, graph: StateGraph, psf: Psf | MultiSensor, stamps: NDArray,
                 weights: NDArray, model: AmplitudeModel):
        self._psf = psf
        self._compiled = psf.compiled(with_curvature=True)
        self._weights = np.asarray(weights, np.float32)
        self._model = model
        self._motions = motions_of(graph, stamps)

    def refine(self, frames: NDArray, positions: NDArray, cost: float, threshold: float,
               t_convex: float) -> tuple[NDArray, float]:
        """Return better positions and their cost, or those given when none is better.

        Parameters
        ----------
        frames : array, shape (T, H, W)
            What is left of the frames after all other paths.
        positions : array, shape (T, 2)
            x and y in pixels.
        cost : float
            Cost of the turns of the given path.
        threshold : float
            lambda of a path without turns.
        t_convex : float
            Place on the continuation.
        """
        limits = self._psf.limits(frames.shape[1:])
        squared = float(self.gains(frames, positions).sum())
        price = cost * self._cost_scale(frames, positions)
        best = (self._fall(frames, positions, squared, price, threshold, t_convex) + LEAST_GAIN,
                positions, cost)
        for start, basis, family_cost in self._motions.candidates(positions, cost):
            moved = np.array(start)
            value = maximise_statistic(moved, basis, self._compiled, limits, frames, self._weights,
                          self._model.code, MOST_STEPS)
            if not self._motions.allowed(moved):
                continue
            moved_cost = family_cost
            if moved_cost is None:
                moved_cost = self._motions.cost(moved)
            moved_cost += self._motions.overspeed_cost(moved)
            cost_scale = self._cost_scale(frames, moved)
            gain = self._fall(frames, moved, value, cost_scale * moved_cost, threshold, t_convex)
            if gain > best[0]:
                best = (gain, moved, moved_cost)
        return best[1], best[2]

    def value(self, frames: NDArray, positions: NDArray, cost: float) -> float:
        """Return the value of a path: what it adds up over the frames less its cost."""
        squared = float(self.gains(frames, positions).sum())
        return self._model.value(math.sqrt(squared)) - cost * self._cost_scale(frames, positions)

    def gains(self, frames: NDArray, positions: NDArray) -> NDArray[np.float64]:
        """Return what each frame adds to the squared statistic of a path, shape (T,)."""
        seen, norms = self._evaluate(frames, positions)
        amplitudes = np.empty(len(positions))
        best_amplitudes(seen, norms, self._model.code, amplitudes)
        return amplitudes**2

    def _evaluate(self, frames, positions):
        seen = np.empty((len(positions), 3))
        norms = np.empty(len(positions))
        evaluate(self._compiled, positions, frames, self._weights, self._model.code, seen, norms)
        return seen, norms

    def _cost_scale(self, frames, positions):
        """Return by how much more the turns of a path cost, see AmplitudeModel."""
        if not (self._model.is_constant and len(self._weights)):
            return 1.0
        return self._model.cost_scale(self._evaluate(frames, positions)[1])

    def _fall(self, frames, positions, squared, cost, threshold, t_convex):
        """Return by how much a path of this squared statistic lowers F_t, alone."""
        if not (self._model.has_one_modulus and t_convex == 1.0):
            return self.lowers(squared, cost, threshold, t_convex)
        # Bounded moduli explain more than equal ones: half the squared norm of what is left of
        # them after shrinkage.
        seen, norms = self._evaluate(frames, positions)
        left = np.array(seen[:, 0])
        clip_moduli(left, self._model.envelope(norms), self._model.weight(threshold, cost))
        return 0.5 * float(left @ left)

    def lowers(self, squared: float, cost: float, threshold: float, t_convex: float) -> float:
        """Return by how much a path of this squared statistic lowers F_t, alone."""
        weight = self._model.weight(threshold, cost)
        excess = math.sqrt(squared) - t_convex * weight
        return 0.5 * max(excess, 0.0)**2 - 0.5 * (1 - t_convex)**2 * weight**2
