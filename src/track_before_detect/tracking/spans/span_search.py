"""One span of the batches of a recording, searched by itself."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import ahead
from track_before_detect.tracking.pipeline import TrackingPipeline, Unlinked
from track_before_detect.tracking.recording import FrameSequence, prepared_batches, Span
from track_before_detect.tracking.repeated_frames import change
from track_before_detect.types import FrameBatch


def changes(recording: FrameSequence, order: Sequence[int]) -> list[float]:
    """Return how much changes from each of some frames to the next."""
    frames = (np.asarray(recording[index]) for index in order)
    return [change(last, frame) for last, frame in pairwise(frames)]


def search_span(recording: FrameSequence, shape: tuple[int, int], options: DetectorOptions,
                span: Span) -> list[Unlinked | None]:
    """Search the batches of a span as a search of the whole recording does.

    Parameters
    ----------
    recording : FrameSequence
        The whole of it, of which the frames of the span are read.
    shape : tuple of int
        (H, W) of its frames.
    options : DetectorOptions
    span : Span

    Returns
    -------
    list
        What is in each batch; None of those that are passed over.
    """
    stamps = np.asarray(recording.stamps, float)
    pipeline = TrackingPipeline(options)
    # Batches take the threshold of an earlier one that is nearly alike.
    pipeline.thresholds([stamps[one] for one in span.earlier], shape)
    found: list[Unlinked | None] = [None] * len(span.batches)
    with closing(ahead(prepared_batches(
            _read(recording, stamps, span.batches), pipeline.prepare_unlinked, len(recording),
            None))) as prepared:
        for batch, _, search in prepared:
            found[batch] = one = search(None)
            # Where the next one begins.
            pipeline.link(one)
    return found


def _read(recording: FrameSequence, stamps: NDArray[np.float64],
          numbers: Sequence[NDArray[np.int64]]) -> Iterator[FrameBatch]:
    """Yield batches of these frames, each of which is read once."""
    held: dict[int, NDArray] = {}
    for one in numbers:
        held = {index: held[index] if index in held else np.asarray(recording[index])
                for index in one.tolist()}
        yield FrameBatch(np.stack(list(held.values())), stamps[one], one)
