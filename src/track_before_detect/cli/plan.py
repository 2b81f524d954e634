"""``tbd plan``: what a search is going to cost, from a few of its batches."""

from argparse import Namespace
from dataclasses import dataclass
from itertools import islice
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.cli.console import FOUND, Progress, table
from track_before_detect.cli.detect import add_input_arguments, chosen_options, told_options
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import map_in_threads
from track_before_detect.recordings.open_recording import expand_inputs
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.saved import Opened
from track_before_detect.timestamps import increasing_frames, median_interval

# Larger frames of few batches are tried on squares in their middle instead: time goes on in
# proportion to the pixels of the larger one, memory as a straight line through both.
_MOST_PIXELS, _MANY_BATCHES = 512**2, 12
_SIDES_PX = (256, 512)
# The first batch begins with no paths, and what its frames cost is not kept for it.
_BATCHES_TRIED = 3


@dataclass(frozen=True)
class Plan:
    """What a search is expected to cost.

    Attributes
    ----------
    n_batches : int
        As many as will be searched, unless frames repeat.
    seconds, cpu_seconds : float
        From start to end, of the clock on the wall and of all cores.
    memory_bytes : float
        Of the process, at most.
    """

    n_batches: int
    seconds: float
    cpu_seconds: float
    memory_bytes: float


HELP = 'say what a search is going to cost'
DESCRIPTION = (
    'Search a few batches in the middle of each recording, or of the middle of '
    'large frames, and\nsay how long tbd detect is going to take with these options, and how '
    'much memory. Loops that\nhave to be compiled and a threshold that has to be calibrated '
    'are made now, and kept for it.\nFilms and pictures are not counted.')
EXAMPLES = ''


def add_arguments(parser: Any) -> None:
    """Add the arguments of the command."""
    add_input_arguments(parser)


def run(arguments: Namespace) -> int:
    """Print what each recording and all together cost; return the exit code."""
    told = told_options(arguments)
    rows, plans = [], []
    for path in expand_inputs(arguments.inputs):
        source = Opened(path, arguments.topic, arguments.fps)
        with source.open() as recording:
            options, _ = chosen_options(recording, arguments, told)
            with Progress.asked_for(arguments) as progress:
                plans.append(_plan(recording, options, source, progress))
            rows.append((recording.name, str(len(recording)),
                         f'{recording.shape[1]} x {recording.shape[0]}', *_cells(plans[-1])))
    if len(plans) > 1:
        rows.append(('all', '', '', *_cells(Plan(
            sum(one.n_batches for one in plans), sum(one.seconds for one in plans),
            sum(one.cpu_seconds for one in plans), max(one.memory_bytes for one in plans)))))
    print(table([('recording', 'frames', 'size [px]', 'batches', 'time [s]', 'CPU time [s]',
                  'memory [GB]'), *rows]))
    return FOUND


def _cells(plan: Plan) -> tuple[str, ...]:
    return (str(plan.n_batches), f'{plan.seconds:.3g}', f'{plan.cpu_seconds:.3g}',
            f'{plan.memory_bytes / 1e9:.2g}')


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
    height, width = recording.shape
    n_batches = _n_batches(recording, parts, length, hop)
    in_part = height * width > _MOST_PIXELS and n_batches < _MANY_BATCHES
    sides = _SIDES_PX if in_part else (max(height, width),)
    n_pixels, costs = [], []
    for done, side in enumerate(sides):
        progress('trying', done / len(sides))
        n_pixels.append(min(side, height) * min(side, width))
        costs.append(in_own_process(_tried, source, options, side))
    start, first, later, memory = costs[-1]
    first, later = (one * (height * width / n_pixels[-1]) for one in (first, later))
    if len(sides) > 1:
        memory += (memory - costs[0][-1]) * (height * width - n_pixels[-1]) / (
            n_pixels[-1] - n_pixels[0])
    seconds, cpu_seconds = start + first + (n_batches - 1) * later
    return Plan(n_batches, float(seconds), float(cpu_seconds), memory)


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
    """A recording of the middle of each frame, at most so many pixels wide and high."""

    def __init__(self, recording: Recording, side: int):
        self._recording = recording
        self._window = tuple(slice((length - min(side, length)) // 2,
                                   (length + min(side, length)) // 2)
                             for length in recording.shape)
        self.share = float(np.prod([min(1.0, side / length) for length in recording.shape]))
        self.stamps = recording.stamps

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int) -> NDArray:
        return self._recording[index][self._window]


def _clocks() -> NDArray[np.float64]:
    """Return the time on the wall, and that which all cores have spent on this process."""
    return np.array([time.perf_counter(), time.process_time()])


def _tried(source: Opened, options: DetectorOptions, side: int,
           ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Search a few batches in the middle; return times (wall, CPU) and memory.

    Until the loops are loaded, of the first batch, and of each later one; then the largest memory.
    """
    began = _clocks()
    from track_before_detect.runs.own_process import peak_memory
    from track_before_detect.solvers.search.memory import BYTES_PER_GB, memory_for_search
    from track_before_detect.tracking.pipeline import TrackingPipeline
    from track_before_detect.tracking.recording import batches

    with source.open() as recording:
        parts, length, hop = _cut(recording, options)
        part = max(parts, key=len)
        middle = _Middle(recording, side)
        if middle.share < 1:
            # The same shares of the paths are held at a time, and nothing is as large as a frame.
            options = options.replace(
                variance=None, mask=None, max_memory_gb=middle.share * memory_for_search(
                    options.max_memory_gb) / BYTES_PER_GB)
        pipeline = TrackingPipeline(options)
        pipeline.compile()
        marks = [_clocks()]
        skipped = max(0, _n_batches(recording, [part], length, hop) - _BATCHES_TRIED) // 2
        cut = batches(middle, [part[skipped * hop:]], recording.stamps, length, hop)
        for batch in islice(cut, _BATCHES_TRIED):
            pipeline.process(batch)
            marks.append(_clocks())
    times = np.diff(marks, axis=0)
    # What was spent before this was called is start-up, too.
    start = marks[0] - began + began[1] * np.array([1, 1])
    later = times[1:].mean(axis=0) if len(times) > 1 else times[0]
    return start, times[0], later, float(peak_memory())
