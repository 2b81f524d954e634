"""Frames of several sensors in, trajectories on their common plane out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
import math

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.capabilities import check_options
from track_before_detect.errors import DataError, TooFewFramesError
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.prepare import prepare, PreparedBatch
from track_before_detect.solvers.batch_detector import FoundTrajectory
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.solvers.path_detector import PathDetector
from track_before_detect.tracking.compilation import LABEL, told_of_compiling
from track_before_detect.tracking.pipeline import BatchSearch
from track_before_detect.tracking.previous_batch import PreviousBatches
from track_before_detect.tracking.sensors import Sensor, SensorPlane
from track_before_detect.types import DetectionResult, FrameBatch, Progress, Remark, Trajectory

# Frames of unit noise, weights of pixels, the unit of amplitudes, and remarks.
_Prepared = tuple[FrameBatch, NDArray, NDArray, list[str]]
DETECTORS: dict[str, type[PathDetector]] = {'convex': ConvexDetector, 'greedy': GreedyDetector}


class SensorPipeline:
    """Preprocessing of each sensor, detection on the plane and identities over batches.

    Parameters
    ----------
    plane : SensorPlane
        What the sensors see together; which of them took a frame is said by the batches.
    options, earlier, detector
        As of :class:`TrackingPipeline`.
    """

    stamps_may_repeat = True

    def __init__(self, plane: SensorPlane, options: DetectorOptions,
                 earlier: SensorPipeline | None = None, detector: PathDetector | None = None):
        check_options(options, several_sensors=True)
        self._plane = plane
        self._options = options
        self._detector = detector or DETECTORS[options.detector](options, plane.measurement)
        self._before: PreviousBatches = PreviousBatches(
            plane.measurement.width_px, earlier._before if earlier else None)

    def warm_up(self, shape: tuple[int, int], interval_s: float, n_frames: int,
                progress: Progress | None = None) -> float:
        """Compile every kernel; return the threshold if it was told, else NaN.

        Which sensor looks when is known of a batch only, and the threshold calibrated for that.
        The parameters are those of :meth:`TrackingPipeline.warm_up`.
        """
        self.compile(progress)
        return math.nan if self._options.threshold is None else self._options.threshold

    def compile(self, progress: Progress | None = None) -> None:
        """Run every kernel once, on a target that two small sensors see."""
        if progress is not None:
            progress(LABEL, 0.0)
        options = self._options.replace(threshold=8.0, max_speed_px_s=None,
                                        max_acceleration_px_s2=None)
        n_sensors, shape = len(self._plane.shapes), (24, 24)
        frames = np.random.default_rng(0).standard_normal((4 * n_sensors, *shape)).astype(
            np.complex64 if options.amplitudes == 'complex' else np.float32)
        frames[:, 10:13, 10:13] += 8
        numbers = np.arange(len(frames))
        batch = FrameBatch(frames, numbers.astype(float), numbers,
                           taken=np.column_stack([numbers % n_sensors, numbers // n_sensors]))
        sensor = Sensor(frames, batch.stamps, psf_sigma_px=1.0)
        small = SensorPipeline(
            SensorPlane([sensor] * n_sensors, [shape] * n_sensors, options), options)
        with told_of_compiling(progress, self._options):
            small.process(batch)
            frames[:, 0, 0] = np.nan
            small.process(batch)
        if progress is not None:
            progress(LABEL, 1.0)

    def process(self, batch: FrameBatch, progress: Progress | None = None) -> DetectionResult:
        """Find the trajectories of a batch; positions are those of the common plane."""
        return self.prepare(batch)(progress)

    def prepare(self, batch: FrameBatch, progress: Progress | None = None) -> BatchSearch:
        """Prepare a batch and return what finds its trajectories; see TrackingPipeline."""
        return partial(self._find, batch, self._prepared(batch))

    def _find(self, batch: FrameBatch, prepared: _Prepared,
              progress: Progress | None = None) -> DetectionResult:
        whole, weights, units, remarks = prepared
        on_plane = np.tile(geometry.translations(self._plane.origin[None]), (len(batch), 1, 1))
        result = self._detector.detect(
            whole, None if np.all(weights == 1) else weights,
            self._before.paths(batch.frame_indices, on_plane), progress)
        linked = self._before.link(
            [self._on_plane(found, units, batch) for found in result.found])
        return DetectionResult(linked, result.threshold, result.status,
                               result.history, result.gap, result.best_statistic,
                               remarks=remarks,
                               threshold_source=self._detector.threshold_source)

    def reset(self) -> None:
        """Forget identities and earlier batches."""
        self._before.reset()

    def _prepared(self, batch: FrameBatch) -> _Prepared:
        """Return frames of unit noise, weights of pixels, the unit of amplitudes, and remarks."""
        plane, of_frame = self._plane, _taken(batch)[:, 0]
        frames = np.full(batch.frames.shape, np.nan, batch.frames.dtype)
        units = np.full(batch.frames.shape, np.nan, np.float32)
        weights = np.zeros(batch.frames.shape, np.float32)
        remarks: list[str] = []
        refused: TooFewFramesError | None = None
        for sensor in np.unique(of_frame):
            rows = np.flatnonzero(of_frame == sensor)
            if not np.isfinite(batch.frames[rows]).any():
                # It looks away; the others go on.
                continue
            try:
                own = self._prepared_of(batch, rows, int(sensor))
            except TooFewFramesError as error:
                # It has begun or ended to send; the others go on.
                refused = error
                remarks += self._before.remarks.new([Remark(
                    f'{sensor} left out', f'sensor {sensor}: {error}; its frames are left out')])
                continue
            remarks += self._before.remarks.new(
                Remark(f'{sensor} {one.kind}', f'sensor {sensor}: {one.text}', one.frames)
                for one in own.remarks)
            height, width = plane.shapes[sensor]
            frames[rows, :height, :width] = own.frames
            plain = own.weights is None
            weights[rows, :height, :width] = 1.0 if plain else own.weights
            units[rows, :height, :width] = plane.noise_sigmas[sensor] * (
                own.noise_level if plain else own.unit)
        if not weights.any():
            raise refused or DataError(f'no pixel of the {len(batch)} frames is finite')
        return replace(batch, frames=frames), weights, units, remarks

    def _prepared_of(self, batch: FrameBatch, rows: NDArray, sensor: int) -> PreparedBatch:
        """Return the frames of one sensor, prepared with what is known of its pixels."""
        plane = self._plane
        height, width = plane.shapes[sensor]
        own = FrameBatch(
            batch.frames[rows, :height, :width] / np.float32(plane.noise_sigmas[sensor]),
            batch.stamps[rows], _taken(batch)[rows, 1])
        options = self._options.replace(variance=plane.variances[sensor],
                                        mask=plane.masks[sensor])
        return prepare(own, options, plane.measurement.psfs[sensor].width_px)

    def _on_plane(self, found: FoundTrajectory, units: NDArray, batch: FrameBatch) -> Trajectory:
        """Return a trajectory on the plane, amplitudes in the units of each frame's sensor."""
        plane, of_frame = self._plane, _taken(batch)[:, 0]
        maps = plane.measurement.maps[of_frame]
        at = np.rint(geometry.apply(maps, found.positions))
        amplitudes = np.full(len(at), np.nan, found.amplitudes.dtype)
        for t, (x, y) in enumerate(at):
            height, width = plane.shapes[of_frame[t]]
            if 0 <= x < width and 0 <= y < height:
                amplitudes[t] = found.amplitudes[t] * units[t, int(y), int(x)]
        present = np.isfinite(found.positions[:, 0])
        positions = found.positions + plane.origin
        moments, first, back = np.unique(batch.stamps[present], return_index=True,
                                         return_inverse=True)
        velocity = np.full_like(positions, np.nan)
        velocity[present] = 0.0
        if len(moments) > 1:
            velocity[present] = np.gradient(positions[present][first], moments, axis=0)[back]
        unknown = np.empty((0, 2, 2))
        return Trajectory(0, positions, amplitudes, velocity, batch.stamps, batch.frame_indices,
                          found.statistic, found.snr, found.reason,
                          unknown if found.covariance is None else found.covariance)


def _taken(batch: FrameBatch) -> NDArray[np.int64]:
    """Return which sensor took each frame, and the number among its own, shape (T, 2)."""
    assert batch.taken is not None
    return batch.taken
