"""Figures 2-7 of US application 18/790,866, and what a run of each may show."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.matching import match_trajectories
from track_before_detect.evaluation.studies.patent import scenes
from track_before_detect.evaluation.studies.patent.scenes import Scene

CONVEX, CONTINUATION, COMBINATORIAL, GREEDY = 'convex', 'continuation', 't = 0 only', 'greedy'
SINGLE_THRESHOLD = 5.0
FALSE_ALARM_RATE = 0.01
# A detection this near to the middle of a pair belongs to it.
NEAR_PX = 16.0
# A target is found when the mean position error over the batch is below this; a rougher trajectory
# of a target too dim for that is not one of something else.
FOUND_PX = 1.5
ROUGH_PX = 2 * scenes.SIGMA_PX

# Told the scene and the positions (K, T) that were found, says whether they show something.
Shows = Callable[[Scene, NDArray], bool]


class Criterion(NamedTuple):
    """What a run may show.

    Attributes
    ----------
    label : str
        Of the report.
    met : callable
        Whether a run shows it.
    goals : mapping
        What is expected, by method.
    """

    label: str
    met: Shows
    goals: Mapping[str, str] = {}


class Figure(NamedTuple):
    """One figure.

    Attributes
    ----------
    number : int
        In the application.
    title : str
        What it shows.
    make : callable
        Draws a scene, told a random generator.
    options : mapping
        Of the detector, beside the method.
    criteria : sequence of Criterion
    """

    number: int
    title: str
    make: Callable[[np.random.Generator], Scene]
    options: Mapping[str, Any]
    criteria: Sequence[Criterion]


def _matched(scene: Scene, found: NDArray, limit_px: float = FOUND_PX) -> NDArray[np.int64]:
    """Return the pairs (trajectory, target), shape (K, 2)."""
    return match_trajectories(_planar(found), _planar(scene.positions), limit_px).pairs


def _planar(positions: NDArray) -> NDArray[np.float64]:
    return np.stack([positions, np.zeros_like(positions)], axis=2)


def _found(target: int) -> Shows:
    return lambda scene, found: target in _matched(scene, found)[:, 1]


def _all_found(scene: Scene, found: NDArray) -> bool:
    return len(_matched(scene, found)) == len(scene.positions)


def _nothing_else(limit_px: float) -> Shows:
    return lambda scene, found: len(_matched(scene, found, limit_px)) == len(found)


def _three_brightest(scene: Scene, found: NDArray) -> bool:
    targets = _matched(scene, found, scenes.SINGLE_SIGMA_PX)[:, 1]
    return len(found) == 3 and sorted(targets) == [0, 1, 2]


def _counts(found: NDArray) -> list[int]:
    """Return how many detections are near each pair."""
    return [int(np.sum(np.abs(found[:, 0] - centre) < NEAR_PX))
            for centre in scenes.PAIR_CENTRES_PX]


def _count_is(pair: int, count: int) -> Shows:
    return lambda scene, found: _counts(found)[pair] == count


def _sides(scene: Scene, found: NDArray) -> NDArray[np.int64]:
    """Return which target each trajectory is nearest to at the start and at the end, (K, 2)."""
    third = len(scene.received) // 3
    distance = np.abs(found[:, None] - scene.positions[None])
    return np.column_stack([distance[:, :, :third].mean(axis=2).argmin(axis=1),
                            distance[:, :, -third:].mean(axis=2).argmin(axis=1)])


def _not_swapped(scene: Scene, found: NDArray) -> bool:
    pairs = _matched(scene, found)
    return len(pairs) == len(scene.positions) and bool(
        np.all(_sides(scene, found)[pairs[:, 0]] == pairs[:, 1:]))


def _swapped(scene: Scene, found: NDArray) -> bool:
    sides = _sides(scene, found).tolist()
    return [0, 1] in sides and [1, 0] in sides


_SINGLE_OPTIONS = {'psf_sigma_px': scenes.SINGLE_SIGMA_PX, 'threshold': SINGLE_THRESHOLD}
_BATCH_OPTIONS = {
    'psf_sigma_px': scenes.SIGMA_PX, 'max_speed_px_s': scenes.MAX_SPEED_PX,
    'max_acceleration_px_s2': scenes.MAX_ACCELERATION_PX, 'false_alarm_rate': FALSE_ALARM_RATE,
}

FIGURES: tuple[Figure, ...] = (
    Figure(2, 'four separate targets in one frame', scenes.separate_single, _SINGLE_OPTIONS, (
        Criterion('the three brightest and nothing else', _three_brightest),)),
    Figure(3, 'pairs at 9, 6 and 3 px in one frame', scenes.pairs_of_distances, _SINGLE_OPTIONS, (
        Criterion('2 detections at 9 px', _count_is(0, 2), {CONTINUATION: 'goal: 97 %'}),
        Criterion('2 detections at 6 px', _count_is(1, 2), {CONTINUATION: 'goal: 97 %'}),
        Criterion('1 detection at 6 px', _count_is(1, 1),
                  {GREEDY: 'expected: at least 70 %'}),
        Criterion('1 detection at 3 px', _count_is(2, 1), {CONTINUATION: 'goal: 97 %'}),
        Criterion('2, 2 and 1 detections', lambda scene, found: _counts(found) == [2, 2, 1]))),
    Figure(4, 'pairs at SNR 30, 12 and 6 in one frame', scenes.pairs_of_snrs, _SINGLE_OPTIONS, (
        Criterion('2 detections at SNR 30', _count_is(0, 2)),
        Criterion('more than 2 detections at SNR 30', lambda scene, found: _counts(found)[0] > 2,
                  {GREEDY: 'expected: mostly'}),
        Criterion('2 detections at SNR 12', _count_is(1, 2)),
        Criterion('1 detection at SNR 12', _count_is(1, 1)),
        Criterion('1 detection at SNR 6', _count_is(2, 1)))),
    Figure(5, 'four separate targets in a batch', scenes.separate, _BATCH_OPTIONS, (
        *(Criterion(f'target of SNR {snr:g} found', _found(target))
          for target, snr in enumerate(scenes.SEPARATE_SNRS)),
        Criterion(f'nothing else, within {ROUGH_PX:g} px', _nothing_else(ROUGH_PX)))),
    Figure(6, 'parallel targets, 5 px apart', scenes.parallel, _BATCH_OPTIONS, (
        Criterion('both found and distinct', _all_found,
                  {CONTINUATION: 'goal: 98 %', GREEDY: 'expected: almost never'}),
        Criterion('nothing else', _nothing_else(FOUND_PX), {CONTINUATION: 'goal: 90 %'}))),
    Figure(7, 'crossing targets of SNR 3 and 2', scenes.crossing, _BATCH_OPTIONS, (
        Criterion('both found and not swapped', _not_swapped,
                  {CONTINUATION: 'goal: 90 %', GREEDY: 'expected: at most 10 %'}),
        Criterion('swapped', _swapped),
        Criterion('nothing else', _nothing_else(FOUND_PX)))),
)
