"""``tbd plan``: what a search is going to cost, from a few of its batches."""

from argparse import Namespace
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
import heapq
from itertools import islice
import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.cli.console import FOUND, Progress, table
from track_before_detect.cli.detect import (
    add_input_arguments,
    add_worker_arguments,
    check_workers,
    chosen_options,
    told_options,
)
from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import ahead, map_in_threads, usable_cores
from track_before_detect.recordings.open_recording import expand_inputs
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.saved import Opened
from track_before_detect.runs.workers import Workers
from track_before_detect.timestamps import increasing_frames, median_interval

# Larger frames of few batches are tried on squares in their middle instead: time goes on in
# proportion to the pixels of the larger one, memory as a straight line through both. Those that
# are searched in tiles are tried on one of these, and on a quarter of them, at least four.
_MOST_PIXELS, _MANY_BATCHES = 512**2, 12
_SIDES_PX = (256, 512)
# The first batch begins with no paths, and what its frames cost is not kept for it.
_BATCHES_TRIED = 3


class Tiles(NamedTuple):
    """The tiles of a frame.

    Attributes
    ----------
    number : int
        Of them.
    shape : tuple of int
        (H, W) of each, with its margin.
    memory_bytes : float
        Of a process that searches nothing but one of them, at most.
    """

    number: int
    shape: tuple[int, int]
    memory_bytes: float = math.nan


@dataclass(frozen=True)
class Plan:
    """What a search is expected to cost.

    Attributes
    ----------
    n_batches : int
        As many as will be searched, unless frames repeat.
    start, search : array, shape (2,)
        Seconds until the loops are loaded, which a process does once, and from there to the end:
        of the clock on the wall, and of all cores.
    memory_bytes : float
        Of the process, at most.
    tiles : Tiles, optional
        Of each frame, where it is searched in some.
    """

    n_batches: int
    start: NDArray[np.float64]
    search: NDArray[np.float64]
    memory_bytes: float
    tiles: Tiles | None = None


HELP = 'say what a search is going to cost'
DESCRIPTION = (
    'Search a few batches in the middle of each recording, or of the middle of '
    'large frames, and\nsay how long tbd detect is going to take with these options, and how '
    'much memory. Loops that\nhave to be compiled and a threshold that has to be calibrated '
    'are made now, and kept for it.\nFilms and pictures are not counted. Of several recordings '
    'the last line is for all of them: one\nafter the other, or on the workers of --scheduler.')
EXAMPLES = """\
examples:
  what one recording costs, and what it costs in tiles:
    tbd plan sky.fits --preset none
    tbd plan sky.fits --preset none --set tile_px=512
  a night of recordings on four workers:
    tbd plan 'night/*.fits' --scheduler local --jobs 4
"""


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)
    add_worker_arguments(parser)


def run(arguments: Namespace) -> int:
    """Print what each recording and all together cost; return the exit code."""
    told, workers = told_options(arguments), _workers(arguments)
    rows, plans = [], []
    for path in expand_inputs(arguments.inputs):
        source = Opened(path, arguments.topic, arguments.fps)
        with source.open() as recording:
            options, _ = chosen_options(recording, arguments, told)
            with Progress.asked_for(arguments) as progress:
                plans.append(plan := _plan(recording, options, source, progress))
            rows.append((recording.name, str(len(recording)),
                         f'{recording.shape[1]} x {recording.shape[0]}', *_tile_cells(plan.tiles),
                         *_cells(plan.n_batches, plan.start + plan.search, plan.memory_bytes)))
    if len(plans) > 1 or workers:
        name = f'all, {workers} worker{"s" * (workers > 1)}' if workers else 'all'
        shared = spans_of(plans[0], workers) if len(plans) == 1 else plans
        rows.append((name, '', '', *_tile_cells(None), *_cells(*together(
            shared, workers, usable_cores() if arguments.scheduler == 'local' else workers))))
    rows.insert(0, ('recording', 'frames', 'size [px]', 'tiles', 'tile [px]', 'tile [GB]',
                    'batches', 'time [s]', 'CPU time [s]', 'memory [GB]'))
    if not any(plan.tiles for plan in plans):
        rows = [row[:3] + row[6:] for row in rows]
    print(table(rows))
    return FOUND


def _workers(arguments: Namespace) -> int:
    """Return how many recordings are searched at a time elsewhere, 0 for none."""
    check_workers(arguments)
    if arguments.scheduler is None:
        return 0
    if arguments.jobs is None and arguments.scheduler != 'local':
        raise ParameterError(f'tbd plan does not ask {arguments.scheduler} how many workers it '
                             'has: tell with --jobs')
    return Workers(arguments.jobs, 'dask').count()


def spans_of(plan: Plan, workers: int) -> list[Plan]:
    """Return what the parts cost into which a single recording is cut for workers.

    Where there are fewer than workers, the tiles of each are cut as well; that each of these parts
    prepares whole frames is not counted.
    """
    from track_before_detect.tracking.recording import SPAN
    from track_before_detect.tracking.spans.span_search import parts_of_tiles
    n_batches = [min(SPAN, plan.n_batches - first) for first in range(0, plan.n_batches, SPAN)]
    n_parts = parts_of_tiles(plan.tiles.number if plan.tiles else 1, len(n_batches), workers)
    return [replace(plan, n_batches=number if part == 0 else 0,
                    search=plan.search * number / plan.n_batches / n_parts)
            for number in n_batches for part in range(n_parts)]


def together(plans: Sequence[Plan], workers: int,
              cores: int) -> tuple[int, NDArray[np.float64], float]:
    """Return batches, seconds (wall, CPU) and bytes of memory of all recordings.

    With no ``workers`` they are searched one after the other in one process. Otherwise each
    worker takes the next one when it is done with its own, which it searches on one core, and
    all that work at a time share ``cores``.
    """
    n_batches = sum(plan.n_batches for plan in plans)
    start, search = plans[0].start, np.sum([plan.search for plan in plans], axis=0)
    memory = sorted((plan.memory_bytes for plan in plans), reverse=True)
    if not workers:
        return n_batches, start + search, memory[0]
    n_used = min(workers, len(plans))
    busy = [float(start[1])] * n_used
    for plan in plans:
        heapq.heapreplace(busy, busy[0] + float(plan.search[1]))
    cpu_seconds = n_used * start[1] + search[1]
    # More workers than cores only wait for one another.
    seconds = max(max(busy), cpu_seconds / cores)
    return n_batches, np.array([seconds, cpu_seconds]), sum(memory[:n_used])


def _tile_cells(tiles: Tiles | None) -> tuple[str, ...]:
    if tiles is None:
        return '', '', ''
    return (str(tiles.number), f'{tiles.shape[1]} x {tiles.shape[0]}',
            f'{tiles.memory_bytes / 1e9:.2g}')


def _cells(n_batches: int, times: NDArray[np.float64], memory_bytes: float) -> tuple[str, ...]:
    return (str(n_batches), *(f'{seconds:.3g}' for seconds in times), f'{memory_bytes / 1e9:.2g}')


def _plan(recording: Recording, options: DetectorOptions, source: Opened,
          progress: Progress) -> Plan:
    """Return what the search of a recording costs."""
    from track_before_detect.runs.own_process import in_own_process
    from track_before_detect.tracking.pipeline import TrackingPipeline

    parts, length, hop = _cut(recording, options)
    stamps = recording.stamps[increasing_frames(recording.stamps)]
    # In a thread of its own, which an interrupt does not wait for.
    [threshold] = map_in_threads(
        lambda pipeline: pipeline.warm_up(recording.shape, median_interval(stamps), length,
                                          progress),
        [TrackingPipeline(options)], progress.show_time)
    if options.calibration == 'noise':
        # Smaller frames would have to be calibrated once more.
        options = options.replace(threshold=threshold)
    n_batches = _n_batches(recording, parts, length, hop)
    tiles = _tiles(recording, options, length)
    trials = _trials(recording.shape, options, tiles, n_batches)
    costs = []
    for done, (shape, to_try) in enumerate(trials):
        progress('trying', done / len(trials))
        costs.append(in_own_process(_tried, source, to_try, shape))
    start, first, later, memory = costs[-1]
    of_frame, tried = math.prod(recording.shape), [math.prod(shape) for shape, _ in trials]
    if len(trials) > 1:
        memory += (memory - costs[0][-1]) * (of_frame - tried[-1]) / (tried[-1] - tried[0])
    search = (first + (n_batches - 1) * later) * (of_frame / tried[-1])
    return Plan(n_batches, start, search, memory,
                tiles and tiles._replace(memory_bytes=costs[0][-1]))


def _tiles(recording: Recording, options: DetectorOptions, length: int) -> Tiles | None:
    """Return the tiles in which the batches of a recording are searched, if there are several."""
    from track_before_detect.option_models import psf_of
    from track_before_detect.solvers.tiles import tile_shape, tiles_of

    if options.tile_px is None:
        return None
    stamps = recording.stamps[increasing_frames(recording.stamps)]
    of = (options, np.arange(length) * median_interval(stamps), recording.shape, psf_of(options))
    tiles = Tiles(len(tiles_of(*of)), tile_shape(*of))
    return tiles if tiles.number > 1 else None


def _trials(shape: tuple[int, int], options: DetectorOptions, tiles: Tiles | None,
            n_batches: int) -> list[tuple[tuple[int, int], DetectorOptions]]:
    """Return the parts of frames (H, W) that are tried, the largest last, with their options."""
    from track_before_detect.solvers.search.memory import BYTES_PER_GB, memory_for_search

    def part(rows: int, columns: int,
             options: DetectorOptions) -> tuple[tuple[int, int], DetectorOptions]:
        tried = min(rows, shape[0]), min(columns, shape[1])
        return tried, options if tried == shape else options.replace(variance=None, mask=None)

    whole = options.replace(tile_px=None)
    if tiles is not None and options.tile_px is not None:
        # The larger part is cut into tiles of the size of those of the frame.
        n_along = -(-max(shape) // options.tile_px)
        core = math.ceil(max(shape) / n_along)
        side = core * max(1 + max(tiles.shape) // core, n_along // 2)
        return [part(*tiles.shape, whole), part(side, side, options.replace(tile_px=core))]
    if math.prod(shape) <= _MOST_PIXELS or n_batches >= _MANY_BATCHES:
        return [part(*shape, whole)]
    # The same shares of the paths are held at a time, and nothing is as large as a frame.
    most_gb = memory_for_search(options.max_memory_gb) / BYTES_PER_GB
    return [part(side, side, whole.replace(
        max_memory_gb=most_gb * min(1.0, side / shape[0]) * min(1.0, side / shape[1])))
        for side in _SIDES_PX]


def _cut(recording: Recording, options: DetectorOptions,
         ) -> tuple[list[NDArray[np.int64]], int, int]:
    """Return the parts of a recording that are searched, and length and hop of its batches."""
    from track_before_detect.tracking.recording import length_and_hop, parts_of

    length, hop = length_and_hop(len(recording), options)
    return parts_of(recording.stamps, length)[0], length, hop


def _n_batches(recording: Recording, parts: list[NDArray[np.int64]], length: int, hop: int) -> int:
    from track_before_detect.tracking.recording import batches

    # Each frame is a number here, for they are only counted.
    frames: Any = np.zeros(len(recording))
    return len(list(batches(frames, parts, recording.stamps, length, hop)))


class _Middle:
    """A recording of the middle (H, W) of each frame."""

    def __init__(self, recording: Recording, shape: tuple[int, int]):
        self._recording = recording
        self._window = tuple(slice((length - side) // 2, (length + side) // 2)
                             for length, side in zip(recording.shape, shape, strict=True))
        self.stamps = recording.stamps

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int) -> NDArray:
        return self._recording[index][self._window]


def _clocks() -> NDArray[np.float64]:
    """Return the time on the wall, and that which all cores have spent on this process."""
    return np.array([time.perf_counter(), time.process_time()])


def _tried(source: Opened, options: DetectorOptions, shape: tuple[int, int],
           ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Search a few batches in the middle; return times (wall, CPU) and memory.

    Until the loops are loaded, of the first batch, and of each later one; then the largest memory.
    """
    began = _clocks()
    from track_before_detect.runs.own_process import peak_memory
    from track_before_detect.tracking.pipeline import TrackingPipeline
    from track_before_detect.tracking.recording import batches

    with source.open() as recording:
        parts, length, hop = _cut(recording, options)
        part = max(parts, key=len)
        middle = _Middle(recording, shape)
        pipeline = TrackingPipeline(options)
        pipeline.compile()
        marks = [_clocks()]
        skipped = max(0, _n_batches(recording, [part], length, hop) - _BATCHES_TRIED) // 2
        cut = batches(middle, [part[skipped * hop:]], recording.stamps, length, hop)
        # As in a whole search, the next one is prepared beside each that is searched.
        with closing(ahead(map(pipeline.prepare, cut))) as prepared:
            for search in islice(prepared, _BATCHES_TRIED):
                search(None)
                marks.append(_clocks())
    times = np.diff(marks, axis=0)
    # What was spent before this was called is start-up, too.
    start = marks[0] - began + began[1] * np.array([1, 1])
    later = times[1:].mean(axis=0) if len(times) > 1 else times[0]
    return start, times[0], later, float(peak_memory())
