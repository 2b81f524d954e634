"""Scenes of figures 2-7 of US application 18/790,866, as its text describes them.

One-dimensional frames, targets blurred by a Gaussian and white noise of unit variance. Where the
text leaves a number open it is chosen here, once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.metrics.matching import match_trajectories

CONVEX, CONTINUATION, COMBINATORIAL, GREEDY = 'convex', 'continuation', 't = 0 only', 'greedy'

# Figures 2-4: one frame.
SINGLE_SIGMA_PX = 3.0
SINGLE_THRESHOLD = 5.0
PAIR_CENTRES_PX = (32.0, 96.0, 160.0)
PAIR_DISTANCES_PX = (9.0, 6.0, 3.0)
PAIR_SNR = 12.0
# At 6 px a second path pays in the mean from SNR 9 on; what greedy leaves of a pair passes the
# threshold on either side from SNR 16 on.
PAIR_SNRS = (30.0, 12.0, 6.0)
PAIR_DISTANCE_PX = 6.0
SEPARATE_SINGLE_SNRS = (14.0, 11.0, 8.0, 3.0)
# A detection this near to the middle of a pair belongs to it.
NEAR_PX = 16.0

# Figures 5-7: a batch, and one motion model for all of them.
SIGMA_PX = 2.0
N_FRAMES = 30
WIDTH_PX = 128
MAX_SPEED_PX = 0.5
MAX_ACCELERATION_PX = 0.01
FALSE_ALARM_RATE = 0.01
DRIFT_PX = 0.2
SEPARATE_SNRS = (4.0, 3.0, 2.0, 1.0)
PARALLEL_PX = 5.0
PARALLEL_SNR = 4.0
CROSSING_SNRS = (3.0, 2.0)
CROSSING_PX = 0.5
# A target is found when the mean position error over the batch is below this; a rougher trajectory
# of a target too dim for that is not one of something else.
FOUND_PX = 1.5
ROUGH_PX = 2 * SIGMA_PX


@dataclasses.dataclass(frozen=True)
class Scene:
    """Targets on a line and what a sensor makes of them.

    Attributes
    ----------
    positions : array, shape (N, T)
        x in pixels.
    snrs : array, shape (N,)
        Amplitude of the unit-norm stamp.
    received : array, shape (T, W)
        Without noise.
    measured : float32 array, shape (T, 1, W)
        With noise of unit variance.
    """

    positions: NDArray[np.float64]
    snrs: NDArray[np.float64]
    received: NDArray[np.float64]
    measured: NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Criterion:
    """What a run may show.

    Attributes
    ----------
    label : str
        Of the report.
    met : callable
        Told the scene and the positions (K, T) that were found, says whether they show it.
    goals : mapping
        What is expected, by method.
    """

    label: str
    met: Callable[[Scene, NDArray], bool]
    goals: Mapping[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Figure:
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


def _scene(positions, snrs, sigma, width, rng):
    """Blur the targets and add noise."""
    positions, snrs = np.asarray(positions, float), np.asarray(snrs, float)
    offset = np.arange(width) - positions[:, :, None]
    # Samples of this Gaussian have unit norm; at sigma of two pixels the sum is an integral.
    stamps = np.exp(-offset**2 / (2 * sigma**2)) / math.sqrt(sigma * math.sqrt(math.pi))
    received = np.einsum('n,ntx->tx', snrs, stamps)
    noise = rng.standard_normal(received.shape)
    return Scene(positions, snrs, received, (received + noise).astype(np.float32)[:, None])


def _separate_single(rng):
    centres = 20.0 + 40.0 * np.arange(4) + rng.uniform(-0.5, 0.5, 4)
    return _scene(centres[:, None], SEPARATE_SINGLE_SNRS, SINGLE_SIGMA_PX, 160, rng)


def _pairs(distances, snrs, rng):
    centres = np.array(PAIR_CENTRES_PX) + rng.uniform(-0.5, 0.5, 3)
    half = 0.5 * np.array(distances)
    positions = np.column_stack([centres - half, centres + half]).reshape(-1, 1)
    return _scene(positions, np.repeat(snrs, 2), SINGLE_SIGMA_PX, 192, rng)


def _time():
    return np.arange(N_FRAMES) - 0.5 * (N_FRAMES - 1)


def _separate(rng):
    start = 16.0 + 32.0 * np.arange(4) + rng.uniform(-0.5, 0.5, 4)
    speed = rng.uniform(-DRIFT_PX, DRIFT_PX, 4)
    acceleration = rng.uniform(-MAX_ACCELERATION_PX, MAX_ACCELERATION_PX, 4)
    time = _time()
    positions = (start[:, None] + speed[:, None] * time
                 + 0.5 * acceleration[:, None] * (time**2 - np.mean(time**2)))
    return _scene(positions, SEPARATE_SNRS, SIGMA_PX, WIDTH_PX, rng)


def _parallel(rng):
    middle = 0.5 * WIDTH_PX + rng.uniform(-0.5, 0.5) + rng.uniform(-DRIFT_PX, DRIFT_PX) * _time()
    positions = [middle - 0.5 * PARALLEL_PX, middle + 0.5 * PARALLEL_PX]
    return _scene(positions, [PARALLEL_SNR] * 2, SIGMA_PX, WIDTH_PX, rng)


def _crossing(rng):
    middle = 0.5 * WIDTH_PX + rng.uniform(-0.5, 0.5) + rng.uniform(-DRIFT_PX, DRIFT_PX) * _time()
    apart = 0.5 * CROSSING_PX * _time()
    return _scene([middle + apart, middle - apart], CROSSING_SNRS, SIGMA_PX, WIDTH_PX, rng)


def _matched(scene, found, limit_px=FOUND_PX):
    """Return the pairs (trajectory, target), shape (K, 2)."""
    return match_trajectories(_planar(found), _planar(scene.positions), limit_px).pairs


def _planar(positions):
    return np.stack([positions, np.zeros_like(positions)], axis=2)


def _found(target):
    return lambda scene, found: target in _matched(scene, found)[:, 1]


def _all_found(scene, found):
    return len(_matched(scene, found)) == len(scene.positions)


def _nothing_else(limit_px):
    return lambda scene, found: len(_matched(scene, found, limit_px)) == len(found)


def _three_brightest(scene, found):
    targets = _matched(scene, found, SINGLE_SIGMA_PX)[:, 1]
    return len(found) == 3 and sorted(targets) == [0, 1, 2]


def _count_near(pair):
    return lambda found: int(np.sum(np.abs(found[:, 0] - PAIR_CENTRES_PX[pair]) < NEAR_PX))


def _count_is(pair, count):
    near = _count_near(pair)
    return lambda scene, found: near(found) == count


def _count_above(pair, count):
    near = _count_near(pair)
    return lambda scene, found: near(found) > count


def _pair_counts(counts):
    return lambda scene, found: all(
        _count_near(pair)(found) == count for pair, count in enumerate(counts))


def _sides(scene, found):
    """Return which target each trajectory is nearest to at the start and at the end, (K, 2)."""
    third = len(scene.received) // 3
    distance = np.abs(found[:, None] - scene.positions[None])
    return np.column_stack([distance[:, :, :third].mean(axis=2).argmin(axis=1),
                            distance[:, :, -third:].mean(axis=2).argmin(axis=1)])


def _not_swapped(scene, found):
    pairs = _matched(scene, found)
    if len(pairs) < len(scene.positions):
        return False
    return bool(np.all(_sides(scene, found)[pairs[:, 0]] == pairs[:, 1:]))


def _swapped(scene, found):
    if not len(found):
        return False
    sides = _sides(scene, found).tolist()
    return [0, 1] in sides and [1, 0] in sides


_SINGLE_OPTIONS = {'psf_sigma_px': SINGLE_SIGMA_PX, 'threshold': SINGLE_THRESHOLD}
_BATCH_OPTIONS = {
    'psf_sigma_px': SIGMA_PX, 'max_speed_px_s': MAX_SPEED_PX,
    'max_acceleration_px_s2': MAX_ACCELERATION_PX, 'false_alarm_rate': FALSE_ALARM_RATE,
}

FIGURES: tuple[Figure, ...] = (
    Figure(2, 'four separate targets in one frame', _separate_single, _SINGLE_OPTIONS, (
        Criterion('the three brightest and nothing else', _three_brightest),)),
    Figure(3, 'pairs at 9, 6 and 3 px in one frame',
           lambda rng: _pairs(PAIR_DISTANCES_PX, [PAIR_SNR] * 3, rng), _SINGLE_OPTIONS, (
        Criterion('2 detections at 9 px', _count_is(0, 2), {CONTINUATION: 'goal: 97 %'}),
        Criterion('2 detections at 6 px', _count_is(1, 2), {CONTINUATION: 'goal: 97 %'}),
        Criterion('1 detection at 6 px', _count_is(1, 1),
                  {GREEDY: 'expected: at least 70 %'}),
        Criterion('1 detection at 3 px', _count_is(2, 1), {CONTINUATION: 'goal: 97 %'}),
        Criterion('2, 2 and 1 detections', _pair_counts((2, 2, 1))))),
    Figure(4, 'pairs at SNR 30, 12 and 6 in one frame',
           lambda rng: _pairs([PAIR_DISTANCE_PX] * 3, PAIR_SNRS, rng), _SINGLE_OPTIONS, (
        Criterion('2 detections at SNR 30', _count_is(0, 2)),
        Criterion('more than 2 detections at SNR 30', _count_above(0, 2),
                  {GREEDY: 'expected: mostly'}),
        Criterion('2 detections at SNR 12', _count_is(1, 2)),
        Criterion('1 detection at SNR 12', _count_is(1, 1)),
        Criterion('1 detection at SNR 6', _count_is(2, 1)))),
    Figure(5, 'four separate targets in a batch', _separate, _BATCH_OPTIONS, (
        *(Criterion(f'target of SNR {snr:g} found', _found(target))
          for target, snr in enumerate(SEPARATE_SNRS)),
        Criterion(f'nothing else, within {ROUGH_PX:g} px', _nothing_else(ROUGH_PX)))),
    Figure(6, 'parallel targets, 5 px apart', _parallel, _BATCH_OPTIONS, (
        Criterion('both found and distinct', _all_found,
                  {CONTINUATION: 'goal: 98 %', GREEDY: 'expected: almost never'}),
        Criterion('nothing else', _nothing_else(FOUND_PX), {CONTINUATION: 'goal: 90 %'}))),
    Figure(7, 'crossing targets of SNR 3 and 2', _crossing, _BATCH_OPTIONS, (
        Criterion('both found and not swapped', _not_swapped,
                  {CONTINUATION: 'goal: 90 %', GREEDY: 'expected: at most 10 %'}),
        Criterion('swapped', _swapped),
        Criterion('nothing else', _nothing_else(FOUND_PX)))),
)
