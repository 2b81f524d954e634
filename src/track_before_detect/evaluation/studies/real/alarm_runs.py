"""Single runs of the suite ``real-alarms``: what passes in a recording without its targets."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.studies.real.labelled import find_recordings
from track_before_detect.evaluation.studies.real.truth import FRAME, HEIGHT, Truth, WIDTH, X, Y
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    EarlierPaths,
    FoundTrajectory,
)
from track_before_detect.solvers.calibration.noise_study import NoiseStudy
from track_before_detect.solvers.clutter.detector import SEPARATION
from track_before_detect.solvers.clutter.reasons import LONGEST_PX
from track_before_detect.tracking.pipeline import detector_for, TrackingPipeline
from track_before_detect.tracking.presets import choose_for
from track_before_detect.tracking.recording import detect_recording
from track_before_detect.types import FrameBatch, Progress

# What nothing was found at in a batch.
NO_ALARM = 1.0


def search(item: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Search the batches of one recording with the places of its targets taken out.

    Parameters
    ----------
    item : mapping
        ``data`` (folder), ``recording`` (name in it), ``told`` (options that override those of
        ``preset=auto``) and ``rates`` (false alarm rates).

    Returns
    -------
    dict
        ``batches``: for each its ``first_frame``, the smallest ``rate`` at which there was a
        trajectory, :data:`NO_ALARM` where there was none, and the median ``x`` and ``y`` of the
        strongest.
    """
    labelled = find_recordings(Path(item['data']))[item['recording']].open()
    with labelled.recording as recording:
        options = choose_for(recording, 'auto', item['told']).options
        detector = WithoutTargets(options, item['rates'], labelled.truth)
        detect_recording(recording, options, pipeline=TrackingPipeline(options, detector=detector))
    return {'batches': [{'first_frame': first, 'rate': rate, 'x': x, 'y': y}
                        for first, (rate, x, y) in sorted(detector.alarms.items())]}


class WithoutTargets(BatchDetector):
    """Searches batches without the places at which something is known to be, at several rates.

    These are taken out of the prepared frames, as the search for what stands out from clutter
    sets a target aside: the residual is that of the whole scene. Taken out are the places of all
    frames of a batch in each: a target that hovers leaves its shadow in a median over time where
    it was before. What passes at a rate passes at every larger one, so the smaller is searched
    only where the larger finds something.

    Parameters
    ----------
    options : DetectorOptions
        Of a search on the pixels of the frames as they came.
    rates : sequence of float
        False alarm rates of a batch.
    truth : Truth
        What is there. Batches with frames of which it knows nothing do not count.

    Attributes
    ----------
    alarms : dict
        By the first frame of each batch the smallest rate at which there was a trajectory, beside
        whatever background, and its x and y.
    """

    def __init__(self, options: DetectorOptions, rates: Sequence[float], truth: Truth):
        super().__init__(options)
        self._detectors = {rate: detector_for(options.replace(false_alarm_rate=rate))
                           for rate in sorted(rates, reverse=True)}
        self._truth = truth
        # Two paths farther apart share no pixel that matters to either.
        self._apart = SEPARATION * psf_of(options).width_px
        self.alarms: dict[int, tuple[float, float, float]] = {}

    def noise_study(self, stamps: NDArray, shape: tuple[int, int]) -> NoiseStudy:
        """Return that of any of the detectors."""
        return next(iter(self._detectors.values())).noise_study(stamps, shape)

    def detect(self, batch: FrameBatch, weights: NDArray | None = None,
               earlier: EarlierPaths | None = None,
               progress: Progress | None = None) -> BatchResult:
        """Find what is nowhere near a target, at the largest rate."""
        taken = places_of(self._truth, batch.frame_indices, batch.frames.shape[1:], self._apart)
        batch = FrameBatch(np.where(taken, np.float32(0), batch.frames), batch.stamps,
                           batch.frame_indices, batch.scene)
        results: list[BatchResult] = []
        least, strongest = NO_ALARM, None
        for rate, detector in self._detectors.items():
            results.append(detector.detect(batch, weights, None, progress))
            if not results[-1].found:
                break
            least, strongest = rate, results[-1].found[0]
        if self._truth.known[batch.frame_indices].all():
            first = int(batch.frame_indices[0])
            found = (least, *_middle(strongest))
            self.alarms[first] = min(found, self.alarms.get(first, found))
        return results[0]


def places_of(truth: Truth, frames: NDArray[np.int64], shape: tuple[int, ...],
              margin_px: float) -> NDArray[np.bool_]:
    """Return which pixels (H, W) are near anything that is known to be there in some frame.

    Parameters
    ----------
    truth : Truth
        What is there; a target that is labelled as a point is taken to be as long as one can be.
    frames : array of int
        The frames.
    shape : tuple of int
        Height and width.
    margin_px : float
        How far beyond a target is near.
    """
    labels = truth.labels[np.isin(truth.labels[:, FRAME], frames)]
    size = np.where(labels[:, [WIDTH, HEIGHT]] > 0, labels[:, [WIDTH, HEIGHT]], LONGEST_PX)
    boxes = [np.hstack([labels[:, [X, Y]], size / 2])]
    for other in truth.others:
        centres = other.places(len(truth.known))[frames]
        centres = centres[np.isfinite(centres[:, 0])]
        boxes.append(np.hstack([centres, np.broadcast_to(other.half_size_px, centres.shape)]))
    row, column = np.indices(shape)
    taken = np.zeros(shape, bool)
    for x, y, half_width, half_height in np.concatenate(boxes):
        taken |= ((np.abs(column - x) <= half_width + margin_px)
                  & (np.abs(row - y) <= half_height + margin_px))
    return taken


def _middle(trajectory: FoundTrajectory | None) -> tuple[float, float]:
    """Return the median x and y of a trajectory; NaN of none."""
    if trajectory is None:
        return float('nan'), float('nan')
    x, y = np.nanmedian(trajectory.positions, axis=0)
    return float(x), float(y)
