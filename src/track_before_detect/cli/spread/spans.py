"""One recording, whose spans of batches, and tiles of large frames, many workers search."""

from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
import dataclasses
from itertools import islice
import logging
import math
from pathlib import Path
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.cli.spread.kept_items import (
    FINISHED,
    states_of,
    with_estimate,
    with_whole_names,
    workers_of,
)
from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.recording import Recording
from track_before_detect.results.saved import Opened
from track_before_detect.runs.kept_results import KeptResults
from track_before_detect.runs.runner import Item, Measure, Runner
from track_before_detect.runs.workers import Workers
from track_before_detect.tracking import remarks
from track_before_detect.tracking.pipeline import BACKGROUNDS, Unlinked
from track_before_detect.tracking.recording import SharedSearch, Span
from track_before_detect.tracking.spans.as_json import as_ends, as_json, from_ends, from_json
from track_before_detect.tracking.spans.span_search import (
    changes,
    of_all_tiles,
    parts_of_tiles,
    search_span,
)
from track_before_detect.types import Progress, within

# Frames in which repeats are looked for at a time.
_READ = 200
# The recording that a thread has open, and by what it was told.
_kept = threading.local()


@contextmanager
def on_workers(source: Opened, arguments: Namespace,
               ) -> Iterator[Callable[[DetectorOptions, tuple[int, int]], SharedSearch]]:
    """Yield what has a recording (H, W) searched by workers with the options that are chosen."""
    with workers_of(arguments).staying() as workers:
        kept = KeptResults(Path(arguments.output) / FINISHED)
        yield lambda options, shape: _Spans(source, shape, options, workers, kept)


@dataclasses.dataclass(frozen=True)
class _Spans:
    """Has the spans of a recording searched; see :class:`SharedSearch`."""

    source: Opened
    shape: tuple[int, int]
    options: DetectorOptions
    workers: Workers
    kept: KeptResults

    def changes(self, order: NDArray[np.int64], progress: Progress | None) -> Iterator[float]:
        """Yield how much changes from each of some frames to the next."""
        shared = self._input({})
        items = [{**shared, 'frames': order[first:first + _READ + 1].tolist()}
                 for first in range(0, len(order) - 1, _READ)]
        told = with_estimate(progress or _untold, len(items))
        for result in self._each(changes_of, items, 'reading', told):
            yield from result['changes']

    def found(self, spans: Sequence[Span],
              progress: Progress | None) -> Iterator[list[Unlinked | None]]:
        """Yield what is in each batch of each span, None in those that are passed over."""
        options = with_whole_names({
            field.name: value for field in dataclasses.fields(self.options)
            if (value := getattr(self.options, field.name)) != field.default})
        shared = {**self._input(options), 'options': options}
        n_parts = self._parts_of_tiles(len(spans))
        if n_parts > 1:
            yield from self._found_in_tiles(spans, n_parts, shared, progress)
            return
        items = [{**shared, **_of_span(span), 'is_first': not number}
                 for number, span in enumerate(spans)]
        told = with_estimate(progress or _untold, len(items))
        for result in self._each(span_of, items, 'searching', told):
            yield from_json(result['found'])

    def _found_in_tiles(self, spans: Sequence[Span], n_parts: int, shared: Item,
                        progress: Progress | None) -> Iterator[list[Unlinked | None]]:
        """Yield as :meth:`found`, of spans whose tiles are searched in parts.

        A batch begins with the paths of the one before, in whatever tile, so that the n-th batches
        of all spans are searched at a time.
        """
        found: list[list[Unlinked | None]] = [[] for _ in spans]
        n_batches = max(len(span.batches) for span in spans)
        told = with_estimate(progress or _untold, n_parts * sum(
            len(span.batches) for span in spans))
        for number in range(n_batches):
            these = [which for which, span in enumerate(spans) if number < len(span.batches)]
            items = []
            for which in these:
                own = spans[which].batches
                before = [one for one in found[which] if one is not None]
                # It takes the threshold of an earlier one that is nearly alike.
                span = Span([own[number]], [*spans[which].earlier, *own[:number]])
                items += [{**shared, **_of_span(span), 'part': [part, n_parts],
                           'before': as_json(before[-1] if before else None),
                           'is_first': not (which or number or part)} for part in range(n_parts)]
            results = self._each(span_of, items, 'searching', within(
                told, number / n_batches, (number + 1) / n_batches))
            parts = iter([from_json(result['found'][0]) for result in results])
            for which in these:
                found[which].append(of_all_tiles(list(islice(parts, n_parts))))
        yield from found

    def _parts_of_tiles(self, n_spans: int) -> int:
        """Return in how many parts the tiles of each span are searched.

        What is found beside several backgrounds is compared over the whole frame.
        """
        tile_px = self.options.tile_px
        if tile_px is None or not n_spans or self.options.background in BACKGROUNDS:
            return 1
        n_tiles = math.prod(-(-length // tile_px) for length in self.shape)
        return parts_of_tiles(n_tiles, n_spans, self.workers.count())

    def _input(self, options: Mapping[str, Any]) -> dict[str, Any]:
        return {**self.source.as_mapping(), 'files': states_of(self.source.path, options)}

    def _each(self, measure: Measure, items: Sequence[Item], label: str,
              progress: Progress) -> list[dict[str, Any]]:
        """Return the result of each item, in their order; all are kept before one is missed."""
        results: list[dict[str, Any]] = [{}] * len(items)
        runner = Runner(progress, self.workers, self.kept)
        with closing(runner.each(measure, items, label, lambda item, result: bool(result),
                                 lambda item: {})) as each:
            for number, result in each:
                results[number] = result
        missing = [number for number, result in enumerate(results) if not result]
        if missing:
            raise DataError(
                f'every worker died that was at part {missing[0] + 1} of {len(items)} of it, as '
                'where memory runs out')
        return results


def changes_of(item: Item) -> dict[str, Any]:
    """Return how much changes between the frames of an item."""
    return {'changes': changes(_opened(item), item['frames'])}


def _untold(label: str, share: float) -> None:
    """Tell nobody of progress."""


def _of_span(span: Span) -> dict[str, Any]:
    """Return what an item holds of a span."""
    return {name: [as_ends(one) for one in batches] for name, batches in span._asdict().items()}


def span_of(item: Item) -> dict[str, Any]:
    """Search the span of an item, or a part of its tiles."""
    recording = _opened(item)
    # Remarks are said when spans are joined, and what the first one says of pixels by that alone.
    with (_errors_alone(remarks.__name__),
          nullcontext() if item['is_first'] else _errors_alone('track_before_detect')):
        return {'found': as_json(search_span(
            recording, recording.shape, DetectorOptions.from_mapping(item['options']),
            Span(*([from_ends(one) for one in item[name]] for name in Span._fields)),
            tuple(item.get('part', (0, 1))), from_json(item.get('before'))))}


@contextmanager
def _errors_alone(name: str) -> Iterator[None]:
    """Let a logger tell of errors alone during the block."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _opened(item: Item) -> Recording:
    """Return the recording of an item, kept while its files are the same: opening may decode it.

    Each thread has its own, because what reads frames is made for one reader.
    """
    source = Opened(Path(item['path']), item['topic'], item['fps'])
    told = source, item['files']
    if getattr(_kept, 'told', None) != told:
        _kept.told = None
        if hasattr(_kept, 'recording'):
            _kept.recording.close()
        _kept.recording = source.open()
        _kept.told = told
    return _kept.recording
