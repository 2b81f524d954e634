"""The threshold that a requested false alarm rate asks for, found by searching noise.

The largest value of any path in pure noise is simulated on crops of the frame. Crops are
independent and alike, so the number of false paths in a frame is Poisson with a mean that grows
with the effective area; the far tail of the squared crop maxima is close to exponential.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import hashlib
import logging
import os
from pathlib import Path
import tempfile
import threading

import numpy as np
from numpy.typing import NDArray

from track_before_detect.models.amplitudes import AmplitudeModel
from track_before_detect.models.psf import GaussianPsf
from track_before_detect.models.state_graph import StateGraph
from track_before_detect.solvers.path_search import PathSearch

_LOG = logging.getLogger(__name__)

# Crops are as large as the frame up to this side: maxima of small crops cannot be scaled to large
# frames exactly, since paths near a border have fewer ways to go.
CROP_PX = 128
# Area searched for a calibration, in crops of full size; smaller ones are searched more of.
N_CROPS = 800
MOST_CROPS = 4000
# Number of largest maxima that the exponential tail is fitted to: enough for its slope, and few,
# because the slope grows slowly all the way out.
N_TAIL = 150
SEED = 20240720
# Part of the key of every cached calibration: change it when the search gives other values.
REVISION = 2

Progress = Callable[[str, float], None]


def threshold_for(graph: StateGraph, psf: GaussianPsf, model: AmplitudeModel,
                  shape: tuple[int, int], rate: float,
                  progress: Progress | None = None) -> float:
    """Return the threshold on the statistic for a false alarm rate.

    Parameters
    ----------
    graph : StateGraph
        The paths that are searched.
    psf : GaussianPsf
        What a target looks like.
    model : AmplitudeModel
        Of the amplitudes.
    shape : tuple of int
        (H, W) of the frames.
    rate : float
        Probability that a batch of pure noise holds a path above the threshold.
    progress : callable, optional
        Called with a label and the share done, 0 to 1.
    """
    crop = (min(shape[0], CROP_PX), min(shape[1], CROP_PX))
    values = _noise_maxima(graph, psf, model, crop, progress)
    # The square of a statistic has the tail nearest to an exponential.
    maxima = np.array([model.from_value(value) for value in values])**2
    areas = effective_area(graph, shape) / effective_area(graph, crop)
    return float(np.sqrt(_tail_value(maxima, -np.log1p(-rate) / areas)))


def effective_area(graph: StateGraph, shape: tuple[int, int]) -> float:
    """Return the number of pixels in which a straight path can start and stay inside."""
    extent = graph.step_px * np.abs(graph.end_moves.sum(axis=0))
    room = np.maximum(np.array([shape[1], shape[0]]) - extent, 0.5)
    return float(np.mean(room[:, 0] * room[:, 1]))


def _tail_value(maxima, mean_count):
    """Value that ``mean_count`` paths in a crop pass on average."""
    ordered = np.sort(maxima)
    tail = N_TAIL / len(ordered)
    start = float(np.quantile(ordered, 1 - tail))
    if mean_count > -np.log1p(-tail):
        return float(np.quantile(ordered, np.exp(-mean_count)))
    scale = float(np.mean(ordered[ordered > start])) - start
    return start + scale * float(np.log(-np.log1p(-tail) / mean_count))


def _noise_maxima(graph, psf, model, crop, progress):
    """Return the largest path value of each crop of noise, from the cache where it is known."""
    path = _cache_folder() / f'noise-{_key(graph, psf, model, crop)}.npy'
    try:
        maxima = np.load(path, allow_pickle=False)
        if maxima.shape == (_crop_count(crop),) and np.all(np.isfinite(maxima)):
            return maxima
    except (OSError, ValueError, EOFError):
        pass
    maxima = _simulate(graph, psf, model, crop, progress)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            np.save(file, maxima)
        os.replace(file.name, path)
    except OSError as error:
        _LOG.warning('the threshold calibration could not be kept for the next run: %s', error)
    return maxima


def _simulate(graph, psf, model, crop, progress):
    """Search crops of noise on all cores; each crop has its own seed, so order is no matter."""
    local = threading.local()
    done = 0
    lock = threading.Lock()
    n_crops = _crop_count(crop)
    seeds = np.random.SeedSequence(SEED).spawn(n_crops)

    def largest(seed):
        nonlocal done
        if not hasattr(local, 'search'):
            local.search = PathSearch(graph, psf, crop, model)
        noise = np.random.default_rng(seed).standard_normal(
            (graph.n_frames, *crop), dtype=np.float32)
        value = local.search.best_value(noise)
        with lock:
            done += 1
            if progress is not None and done % 10 == 0:
                progress('calibrating the threshold on noise', done / n_crops)
        return value

    with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
        return np.array(list(pool.map(largest, seeds)))


def _crop_count(crop):
    return min(round(N_CROPS * CROP_PX**2 / (crop[0] * crop[1])), MOST_CROPS)


def _key(graph, psf, model, crop):
    digest = hashlib.sha256()
    for array in (graph.knots, graph.row_first, graph.row_x, graph.moves, graph.end_moves):
        digest.update(np.ascontiguousarray(array, dtype=np.int64).tobytes())
    digest.update(repr((REVISION, _crop_count(crop), SEED, crop, psf, model, graph.reach,
                        graph.turn_cost, graph.step_px)).encode())
    return digest.hexdigest()[:24]


def _cache_folder() -> Path:
    base = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(base) / 'track_before_detect'


def usable_cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def regular_stamps(stamps: NDArray) -> NDArray[np.float64]:
    """Return stamps in units of their median interval, each interval rounded to quarters of it.

    So the jitter of a clock does not ask for a calibration of its own.
    """
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    intervals = np.diff(stamps)
    quarters = np.maximum(np.rint(4 * intervals / np.median(intervals)), 1) / 4
    return np.append(0.0, np.cumsum(quarters))
