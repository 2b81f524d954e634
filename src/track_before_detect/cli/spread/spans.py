"""One long recording, whose spans of batches are searched by many workers."""

from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
import dataclasses
import logging
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
from track_before_detect.tracking.pipeline import Unlinked
from track_before_detect.tracking.recording import SharedSearch, Span
from track_before_detect.tracking.spans.as_json import as_ends, as_json, from_ends, from_json
from track_before_detect.tracking.spans.span_search import changes, search_span
from track_before_detect.types import Progress

# Frames in which repeats are looked for at a time.
_READ = 200
# The recording that a thread has open, and by what it was told.
_kept = threading.local()


@contextmanager
def on_workers(source: Opened, arguments: Namespace,
               ) -> Iterator[Callable[[DetectorOptions], SharedSearch]]:
    """Yield what has a recording searched by workers with the options that are chosen."""
    with workers_of(arguments).staying() as workers:
        kept = KeptResults(Path(arguments.output) / FINISHED)
        yield lambda options: _Spans(source, options, workers, kept)


@dataclasses.dataclass(frozen=True)
class _Spans:
    """Has the spans of a recording searched; see :class:`SharedSearch`."""

    source: Opened
    options: DetectorOptions
    workers: Workers
    kept: KeptResults

    def changes(self, order: NDArray[np.int64], progress: Progress | None) -> Iterator[float]:
        """Yield how much changes from each of some frames to the next."""
        shared = self._input({})
        items = [{**shared, 'frames': order[first:first + _READ + 1].tolist()}
                 for first in range(0, len(order) - 1, _READ)]
        for result in self._each(changes_of, items, 'reading', progress):
            yield from result['changes']

    def found(self, spans: Sequence[Span],
              progress: Progress | None) -> Iterator[list[Unlinked | None]]:
        """Yield what is in each batch of each span, None in those that are passed over."""
        told = {field.name: value for field in dataclasses.fields(self.options)
                if (value := getattr(self.options, field.name)) != field.default}
        options = with_whole_names(told)
        shared = {**self._input(options), 'options': options}
        items = [{**shared, 'span': number, **{
            name: [as_ends(one) for one in batches] for name, batches in span._asdict().items()}}
            for number, span in enumerate(spans)]
        for result in self._each(span_of, items, 'searching', progress):
            yield from_json(result['found'])

    def _input(self, options: Mapping[str, Any]) -> dict[str, Any]:
        return {**self.source.as_mapping(), 'files': states_of(self.source.path, options)}

    def _each(self, measure: Measure, items: Sequence[Item], label: str,
              progress: Progress | None) -> list[dict[str, Any]]:
        """Return the result of each item, in their order; all are kept before one is missed."""
        told = with_estimate(progress or (lambda label, share: None), len(items))
        results: list[dict[str, Any]] = [{}] * len(items)
        runner = Runner(told, self.workers, self.kept)
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


def span_of(item: Item) -> dict[str, Any]:
    """Search the span of an item."""
    recording = _opened(item)
    # Remarks are said when spans are joined, and what the first one says of pixels by that alone.
    with (_errors_alone(remarks.__name__),
          _errors_alone('track_before_detect') if item['span'] else nullcontext()):
        return {'found': as_json(search_span(
            recording, recording.shape, DetectorOptions.from_mapping(item['options']),
            Span(*([from_ends(one) for one in item[name]] for name in Span._fields))))}


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
