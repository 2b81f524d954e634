"""Compiling: which loops a search needs, and telling of them while they are compiled."""

from collections.abc import Iterator
from contextlib import contextmanager
import functools
import importlib
import time

from numba.core import event
from numba.core.dispatcher import Dispatcher

from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.ring.merit_functions import METHODS
from track_before_detect.solvers.search.coarse_to_fine import cells_may_lead
from track_before_detect.types import Count, Progress

LABEL = 'compiling'
_PACKAGE = __name__.split('.')[0]
# Loops that Python calls, as module:function of the kernels; what they call is compiled with them.
# One that is missing here is counted only once it is compiled.
_OF_PIXELS = ('psf.psf_profiles:fill_profiles', 'scores.matched_filter:filter_frame')
_OF_PATHS = (
    *_OF_PIXELS, 'psf.gauss_newton:best_amplitudes', 'psf.gauss_newton:maximise_statistic',
    'psf.measurement:curvatures', 'psf.measurement:evaluate', 'psf.measurement:render_path',
    'psf.psf_stamps:correlate', 'scores.matched_filter:scores_of_frame',
    'search.viterbi:extend_paths', 'search.viterbi_backtrack:pick_peaks',
    'search.viterbi_backtrack:trace_paths',
    *(f'search.viterbi_update:{name}' for name in (
        'changed_states', 'count_blocks', 'largest_by_row', 'raise_stale', 'replace_scores',
        'spread_turns', 'store_scores', 'wanted_before', 'wanted_ends')))
# Where targets may be fast.
_OF_CELLS = tuple(f'search.cells:{name}' for name in (
    'begin_rest', 'extend_cells', 'mark_ends', 'mark_positions', 'place_marked', 'pool_scores',
    'rest_before'))
# Amplitudes of several paths at once, which a threshold from the clutter does not ask for.
_OF_FIT = ('fit.group_lasso:solve', 'fit.least_squares:find_blocks', 'fit.least_squares:solve',
           'psf.psf_stamps:accumulate', 'psf.psf_stamps:overlap')
_OF_MAPS = ('pictures.mapped_motion:mapped_motion', 'warp:sample_with_slope', 'warp:warp')
_OF_SCENES = ('pictures.scene_noise:noise_at', 'pictures.scene_noise:terms_at')
_OF_CANCELLATION = (*_OF_PIXELS, 'transition_dp:find_targets', 'transition_dp:score_pixels')
_OF_DETECTORS = {
    'mt_dp': _OF_CANCELLATION, 'pc_dp': _OF_CANCELLATION,
    'velocity_filter': (
        *_OF_PIXELS, 'psf.gauss_newton:maximise_statistic',
        'psf.psf_stamps:accumulate', 'psf.psf_stamps:render',
        'psf.psf_stamps:statistic_and_slope', 'velocity_stack:best_velocities')}


class _Watch(event.Listener):
    """Counts loops while numba compiles them."""

    def __init__(self, entries: set[str], progress: Progress):
        self._progress = progress
        self._entries = {entry: _with_called(entry) for entry in map(_loop, entries)}
        self._wanted = set().union(*self._entries.values())
        self._compiled: set[Dispatcher] = set()
        self._started = 0.0

    def on_start(self, event: event.Event) -> None:
        if not self._started:
            self._started = time.monotonic()
            self._tell()

    def on_end(self, event: event.Event) -> None:
        loop = event.data['dispatcher']
        if loop.py_func.__module__.split('.')[0] == _PACKAGE:
            self._compiled.add(loop)
            self._tell()

    def _tell(self) -> None:
        # What an earlier process compiled is loaded whole, with all that it calls.
        done = self._compiled.union(*(
            called for entry, called in self._entries.items() if entry.overloads))
        n_done, n_all = len(done), len(self._wanted | done)
        seconds = time.monotonic() - self._started
        try:
            self._progress(LABEL, Count(
                n_done / n_all, f'{n_done} of {n_all} loops, {seconds:.0f} s'))
        except Exception as error:
            raise _Left(error) from error


class _Left(BaseException):
    """Progress has ended the work; numba takes other errors for its own."""


@contextmanager
def told_of_compiling(progress: Progress | None, *options: DetectorOptions) -> Iterator[None]:
    """Tell progress of the loops that are compiled meanwhile, and of how many there are.

    Parameters
    ----------
    progress : callable, optional
        Called with the label ``compiling`` and a :class:`Count`, from when the first loop is
        compiled on.
    *options : DetectorOptions
        Of the searches that the loops are for.
    """
    if progress is None:
        yield
        return
    watch = _Watch(set().union(*map(entries_of, options)), progress)
    try:
        with event.install_listener('numba:compile', watch):
            yield
    except _Left as left:
        raise left.args[0] from None


@functools.cache
def _loop(name: str) -> Dispatcher:
    module, _, loop = name.partition(':')
    return getattr(importlib.import_module(f'{_PACKAGE}.kernels.{module}'), loop)


@functools.cache
def _with_called(loop: Dispatcher) -> frozenset[Dispatcher]:
    """Return a loop and all that it calls, but for those that become a part of their callers."""
    function = loop.py_func
    called = (function.__globals__.get(name) for name in function.__code__.co_names)
    inlined = loop.targetoptions.get('inline') == 'always'
    return frozenset(() if inlined else (loop,)).union(
        *(_with_called(other) for other in called if isinstance(other, Dispatcher)))


def entries_of(options: DetectorOptions) -> tuple[str, ...]:
    """Return the loops that Python calls in a search, as ``module:function`` of the kernels."""
    return _of_search(options) + _of_pictures(options)


def searches_cells(options: DetectorOptions) -> bool:
    """Return whether the paths of fast targets are sought among cells of positions first.

    Unless a speed is told targets are slow. Short batches may ask for it all the same, of which a
    segment has many velocities; it is compiled when such a batch comes.
    """
    return (options.max_speed_px_s is not None
            and _OF_DETECTORS.get(options.detector) is None and options.detector not in METHODS
            and cells_may_lead(options.calibration != 'clutter', options.exposure_s > 0,
                               options.presence == 'partial'))


def _of_search(options: DetectorOptions) -> tuple[str, ...]:
    if options.detector in METHODS:
        method = METHODS[options.detector]
        order = 'first' if method.order == 'cfo' else 'second'
        closing = ('ring.passes:average',) if method.ring else ()
        return (*_OF_PIXELS, f'ring.{order}_order:accumulate', *closing)
    entries = _OF_DETECTORS.get(options.detector, _OF_PATHS)
    if entries is _OF_PATHS:
        entries += _OF_FIT * (options.calibration != 'clutter')
        entries += _OF_CELLS * searches_cells(options)
        entries += ('search.viterbi_backtrack:leave_out',) * (options.presence == 'partial')
    if options.exposure_s > 0:
        entries += ('scores.streak_scores:scores_of_streak',)
    if options.amplitudes == 'complex' and options.amplitude_model != 'fluctuating':
        entries += ('fit.constant_modulus:clip_moduli', 'fit.constant_modulus:descend')
    return entries


def _of_pictures(options: DetectorOptions) -> tuple[str, ...]:
    """Return the loops that Python calls in preprocessing."""
    still = options.background in ('temporal_median', 'temporal_spatial_median', 'either')
    registration, noise = options.registration, options.noise
    wanted = {
        'pictures.boxes:box_mean': registration != 'none' or options.bad_frames == 'find',
        'warp:shift': registration == 'auto' or (registration == 'translation' and still),
        **dict.fromkeys(_OF_MAPS, registration not in ('none', 'translation')),
        'pictures.median_over_time:median_over_time': (
            options.background != 'none' or noise == 'map' or options.bad_pixels == 'find'),
        'pictures.matched_statistic:matched_statistic': (
            noise != 'none' and options.amplitudes != 'complex'),
        'pictures.boxes:ring_level': noise == 'local',
        'warp:nearest': (noise == 'local' and registration != 'none' and options.background
                         not in ('temporal_median', 'temporal_spatial_median')),
        **dict.fromkeys(_OF_SCENES, noise == 'local' and still)}
    return tuple(loop for loop, is_wanted in wanted.items() if is_wanted)
