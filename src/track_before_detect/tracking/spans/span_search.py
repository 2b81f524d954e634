"""One span of the batches of a recording, searched by itself."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import ahead
from track_before_detect.solvers.tiled import each_once
from track_before_detect.tracking.pipeline import detector_for, TrackingPipeline, Unlinked
from track_before_detect.tracking.recording import FrameSequence, prepared_batches, Span
from track_before_detect.tracking.repeated_frames import change
from track_before_detect.types import FrameBatch, Remark, worst_status


def changes(recording: FrameSequence, order: Sequence[int]) -> list[float]:
    """Return how much changes from each of some frames to the next."""
    frames = (np.asarray(recording[index]) for index in order)
    return [change(last, frame) for last, frame in pairwise(frames)]


def search_span(recording: FrameSequence, shape: tuple[int, int], options: DetectorOptions,
                span: Span, part: tuple[int, int] = (0, 1),
                before: Unlinked | None = None) -> list[Unlinked | None]:
    """Search the batches of a span as a search of the whole recording does.

    Parameters
    ----------
    recording : FrameSequence
        The whole of it, of which the frames of the span are read.
    shape : tuple of int
        (H, W) of its frames.
    options : DetectorOptions
    span : Span
    part : tuple of int
        Number of a part of the tiles of the frames, and how many parts there are; see
        :func:`of_all_tiles`.
    before : Unlinked, optional
        What is in the batch before, where the span does not begin afresh.

    Returns
    -------
    list
        What is in each batch; None of those that are passed over.
    """
    stamps = np.asarray(recording.stamps, float)
    pipeline = TrackingPipeline(options, detector=detector_for(options, part))
    # Batches take the threshold of an earlier one that is nearly alike.
    pipeline.thresholds([stamps[one] for one in span.earlier], shape)
    if before is not None:
        pipeline.link(before)
    found: list[Unlinked | None] = [None] * len(span.batches)
    with closing(ahead(prepared_batches(
            _read(recording, stamps, span.batches), pipeline.prepare_unlinked, len(recording),
            None))) as prepared:
        for batch, _, search in prepared:
            found[batch] = one = search(None)
            # Where the next one begins.
            pipeline.link(one)
    return found


def parts_of_tiles(n_tiles: int, n_spans: int, n_workers: int) -> int:
    """Return in how many parts the tiles of each span are searched.

    Each part prepares whole frames anew, so there are only as many as give each worker something
    to do.
    """
    return min(n_tiles, -(-n_workers // n_spans))


def of_all_tiles(parts: Sequence[Unlinked | None]) -> Unlinked | None:
    """Return what is in a batch, told what is in each part of its tiles, in their order.

    It is passed over, None, by all of them or by none.
    """
    known = [part for part in parts if part is not None]
    if len(known) <= 1:
        return known[0] if known else None
    results = [part.result for part in known]
    remarks: list[Remark] = []
    for part in known:
        remarks += [remark for remark in part.remarks if remark not in remarks]
    return replace(known[0], remarks=remarks, result=replace(
        results[0],
        trajectories=each_once(result.trajectories for result in results),
        status=worst_status(result.status for result in results),
        history=[step for result in results for step in result.history],
        gap=float(np.fmax.reduce([result.gap for result in results])),
        best_statistic=float(np.fmax.reduce([result.best_statistic for result in results]))))


def _read(recording: FrameSequence, stamps: NDArray[np.float64],
          numbers: Sequence[NDArray[np.int64]]) -> Iterator[FrameBatch]:
    """Yield batches of these frames, each of which is read once."""
    held: dict[int, NDArray] = {}
    for one in numbers:
        held = {index: held[index] if index in held else np.asarray(recording[index])
                for index in one.tolist()}
        yield FrameBatch(np.stack(list(held.values())), stamps[one], one)
