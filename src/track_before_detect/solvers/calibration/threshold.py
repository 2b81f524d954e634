"""The threshold that a requested false alarm rate asks for.

How many paths of noise pass a level is known without a search for the commonest options, see
``false_paths``; for others noise is searched. The largest statistic in it is simulated on crops of
the frame. Crops are independent and alike, so the number of false trajectories in a frame is
Poisson with a mean that grows with the effective area. How that mean falls off further out than
the maxima reach is known but for one number where the statistic is made of normal ones; otherwise
it is taken to fall exponentially.
"""

import hashlib
import logging
import math
import os
from pathlib import Path
import tempfile
import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from track_before_detect.atomic_files import atomic_path
from track_before_detect.kernels.compiled_cache import user_cache_folder
from track_before_detect.parallel import map_in_threads
from track_before_detect.solvers.calibration.noise_study import CROP_PX, FalsePaths, NoiseStudy
from track_before_detect.types import Progress

_LOG = logging.getLogger(__name__)

# Steps in which crops get smaller where the least number of them would take too long.
SMALLER_PX = 16
# Area searched for a calibration, in crops of full size; smaller ones are searched more of.
N_CROPS = 800
MOST_CROPS = 2800
# CPU time, by formula, that a calibration should take at most, but for the crops it needs at least
# (docs/constants/calibration.md).
MOST_SECONDS = 56.0
LEAST_CROPS = 150
# Share of the maxima, the largest, that the tail is fitted to (docs/constants/calibration.md).
TAIL = 0.25
# Number of largest maxima, and their largest share, that an exponential tail is fitted to: enough
# for its slope, and few, because the slope grows slowly all the way out.
N_EXPONENTIAL = 150
EXPONENTIAL_TAIL = 3 / 16
SEED = 20240720
# Levels between which the one of a model is looked for, from above.
HIGHEST_LEVEL, LEVEL_STEP = 40.0, 0.5
# Part of the key of every cached calibration: change it when the search gives other values.
REVISION = 6


# Where a threshold comes from.
MODEL, CACHED, SIMULATED = 'model', 'cached', 'simulated'


class Calibration(NamedTuple):
    """A threshold on the statistic, and where it comes from: MODEL, CACHED or SIMULATED."""

    threshold: float
    source: str


def calibrate(study: NoiseStudy, shape: tuple[int, int], rate: float,
              progress: Progress | None = None, simulate: bool = False) -> Calibration:
    """Return the threshold on the statistic for a false alarm rate.

    By noise that was searched before for these options, which is the most exact; else by the
    model where there is one; else noise is searched.

    Parameters
    ----------
    study : NoiseStudy
        The detector.
    shape : tuple of int
        (H, W) of the frames.
    rate : float
        Probability that a batch of pure noise holds a trajectory above the threshold.
    progress : callable, optional
        Called with a label and the share done, 0 to 1.
    simulate : bool
        Search noise although there is a model.
    """
    crop = _crop(study, shape)
    kept, source = _known_maxima(study, crop), CACHED
    if kept is None and study.false_paths is not None and not simulate:
        return Calibration(level_passed(study.false_paths, rate), MODEL)
    if kept is None:
        kept, source = _new_maxima(study, crop, progress), SIMULATED
    # The square of a statistic has the tail nearest to an exponential.
    maxima = np.sort(kept**2)
    mean_count = -np.log1p(-rate) * study.area(crop) / study.area(shape)
    value = (_exponential_value(maxima, mean_count) if study.decay is None
             else _chi_squared_value(maxima, mean_count, study.decay))
    return Calibration(math.sqrt(value), source)


def level_passed(false_paths: FalsePaths, rate: float) -> float:
    """Return the level that trajectories of noise pass in this share of the batches."""
    mean_count = -math.log1p(-rate)

    def too_many(level: float) -> float:
        return false_paths(level) - mean_count

    # The number falls with the level from where it is of use; further down theory fails.
    high = HIGHEST_LEVEL
    while too_many(high - LEVEL_STEP) < 0:
        high -= LEVEL_STEP
    return float(brentq(too_many, high - LEVEL_STEP, high))


def _chi_squared_value(ordered: NDArray, mean_count: float, decay: float) -> float:
    """Value of a sum of squares that ``mean_count`` paths in a crop pass on average.

    The sum passes x in about x^k exp(-decay x) places of a crop when x is large (Worsley,
    Local maxima and the expected Euler characteristic of excursion sets of chi-squared, F and t
    fields, 1994), with a power k that grows with the frames and the freedom of paths. It is the
    one that makes the largest maxima likeliest.
    """
    start, count = _tail(ordered, TAIL)
    if mean_count > count:
        return float(np.quantile(ordered, np.exp(-mean_count)))
    far = ordered[ordered > start]
    logarithms = np.log(far / start)

    def passing(power: float) -> NDArray:
        return count * np.exp(power * logarithms - decay * (far - start))

    def likelier(power: float) -> float:
        # Derivative of the log likelihood, for the largest of a crop passes x with probability
        # 1 - exp(-number of places). It falls all the way.
        return float(np.sum((1 - passing(power)) * logarithms - 1 / (decay * far - power)))

    # With the largest power the number does not fall at the start.
    highest = decay * start
    lowest = -highest
    while likelier(lowest) <= 0:
        lowest *= 2
    power = brentq(likelier, lowest, highest) if likelier(highest) < 0 else highest

    def too_many(value: float) -> float:
        return (np.log(count / mean_count) + power * np.log(value / start)
                - decay * (value - start))

    end = 2 * start
    while too_many(end) > 0:
        end *= 2
    return float(brentq(too_many, start, end))


def _exponential_value(ordered: NDArray, mean_count: float) -> float:
    """Value that ``mean_count`` paths in a crop pass on average."""
    start, count = _tail(ordered, min(N_EXPONENTIAL / len(ordered), EXPONENTIAL_TAIL))
    if mean_count > count:
        return float(np.quantile(ordered, np.exp(-mean_count)))
    scale = float(np.mean(ordered[ordered > start])) - start
    return start + scale * float(np.log(count / mean_count))


def _tail(ordered: NDArray, share: float) -> tuple[float, float]:
    """Return where the largest maxima begin, and how many paths of a crop pass it on average."""
    return float(np.quantile(ordered, 1 - share)), -math.log1p(-share)


def _known_maxima(study: NoiseStudy, crop: tuple[int, int]) -> NDArray | None:
    """Return the largest statistic of each crop of noise, None where the cache has none."""
    path = _cache_path(study, crop)
    try:
        return _kept_maxima(path, _crop_count(study, crop))
    except FileNotFoundError:
        pass
    except (OSError, ValueError, TypeError, OverflowError, EOFError) as error:
        _LOG.warning('the threshold calibration in %s cannot be used and is made anew: %s',
                     path, error)
    return None


def _new_maxima(study: NoiseStudy, crop: tuple[int, int], progress: Progress | None) -> NDArray:
    """Search crops of noise and keep the largest statistic of each in the cache."""
    path, maxima = _cache_path(study, crop), _simulate(study, crop, progress)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as aside:
            np.save(aside, maxima)
    except OSError as error:
        _LOG.warning('the threshold calibration could not be kept in %s for the next run: %s',
                     path, error)
    return maxima


def _kept_maxima(path: Path, n_crops: int) -> NDArray:
    """Return the maxima in a file of the cache, or raise where they are none."""
    # Mapped, so that a size that is wrong is refused before memory is asked for it.
    kept = np.load(path, mmap_mode='r', allow_pickle=False)
    if kept.dtype != np.float64 or kept.shape != (n_crops,):
        raise ValueError(f'expected {n_crops} numbers, found shape {kept.shape} of {kept.dtype}')
    maxima = np.array(kept)
    if not np.all(np.isfinite(maxima)) or not 0 < np.quantile(maxima, 1 - TAIL) < maxima.max():
        raise ValueError('expected the largest statistics of noise, found numbers that are none')
    return maxima


def _simulate(study: NoiseStudy, crop: tuple[int, int],
              progress: Progress | None) -> NDArray:
    """Search crops of noise on all cores; each crop has its own seed, so order is no matter."""
    local = threading.local()
    done = 0
    lock = threading.Lock()
    n_crops = _crop_count(study, crop)
    seeds = np.random.SeedSequence(SEED).spawn(n_crops)

    def largest(seed: np.random.SeedSequence) -> float:
        nonlocal done
        if not hasattr(local, 'search'):
            local.search = study.searcher(crop)
        value = local.search(np.random.default_rng(seed))
        with lock:
            done += 1
            if progress is not None and done % 10 == 0:
                progress('calibrating the threshold on noise', done / n_crops)
        return value

    return np.array(map_in_threads(largest, seeds))


def _crop(study: NoiseStudy, shape: tuple[int, int]) -> tuple[int, int]:
    """Return (H, W) of the crops of noise that are searched for frames of a shape."""
    for side in range(CROP_PX, study.least_crop_px - 1, -SMALLER_PX):
        width = shape[1] if study.whole_width else min(shape[1], side)
        crop = (min(shape[0], side), width)
        if LEAST_CROPS * study.seconds(crop) <= MOST_SECONDS:
            break
    return crop


def _crop_count(study: NoiseStudy, crop: tuple[int, int]) -> int:
    wanted = min(round(N_CROPS * CROP_PX**2 / (crop[0] * crop[1])), MOST_CROPS)
    fitting = MOST_SECONDS / max(study.seconds(crop), 1e-9)
    return wanted if fitting >= wanted else min(wanted, max(round(fitting), LEAST_CROPS))


def _key(study: NoiseStudy, crop: tuple[int, int]) -> str:
    text = repr((REVISION, _crop_count(study, crop), SEED, crop, study.key))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def _cache_path(study: NoiseStudy, crop: tuple[int, int]) -> Path:
    return _cache_folder() / f'noise-{_key(study, crop)}.npy'


def _cache_folder() -> Path:
    try:
        return user_cache_folder()
    except RuntimeError:
        # A user of a container may have no home at all.
        return Path(tempfile.gettempdir()) / f'track_before_detect-{os.getuid()}'
