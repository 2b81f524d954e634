"""Frames of several sensors in, trajectories on their common plane out."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.capabilities import check_options
from track_before_detect.errors import DataError
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.prepare import prepare, PreparedBatch
from track_before_detect.solvers.batch_detector import FoundTrajectory
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.solvers.path_detector import PathDetector
from track_before_detect.tracking.previous_batch import map_previous_batch
from track_before_detect.tracking.remarks import Remarks
from track_before_detect.tracking.sensors import SensorArray
from track_before_detect.tracking.stitcher import Stitcher
from track_before_detect.types import DetectionResult, FrameBatch, Progress, Remark, Trajectory

DETECTORS: dict[str, type[PathDetector]] = {'convex': ConvexDetector, 'greedy': GreedyDetector}


class SensorPipeline:
    """Preprocessing of each sensor, detection on the plane and identities over batches.

    Parameters
    ----------
    array : SensorArray
        The frames that batches are made of.
    options : DetectorOptions
        What to look for and how.
    detector : PathDetector, optional
        The detector that the options name unless given.
    """

    stamps_may_repeat = True

    def __init__(self, array: SensorArray, options: DetectorOptions,
                 detector: PathDetector | None = None):
        check_options(options, several_sensors=True)
        self._array = array
        self._options = options
        self._detector = detector or DETECTORS[options.detector](options, array.measurement)
        self._stitcher = Stitcher(array.measurement.width_px)
        self._before: list[Trajectory] = []
        self._remarks = Remarks()

    def process(self, batch: FrameBatch, progress: Progress | None = None) -> DetectionResult:
        """Find the trajectories of a batch; positions are those of the common plane."""
        whole, weights, units, remarks = self._prepared(batch)
        on_plane = np.tile(geometry.translations(self._array.origin[None]), (len(batch), 1, 1))
        result = self._detector.detect(
            whole, None if np.all(weights == 1) else weights,
            map_previous_batch(self._before, batch.frame_indices, on_plane), progress)
        self._before = self._stitcher.link(
            [self._on_plane(found, units, batch) for found in result.found])
        return DetectionResult(list(self._before), result.threshold, result.status,
                               result.history, result.gap, result.best_statistic,
                               remarks=remarks)

    def _prepared(self, batch: FrameBatch) -> tuple[FrameBatch, NDArray, NDArray, list[str]]:
        """Return frames of unit noise, weights of pixels, the unit of amplitudes, and remarks."""
        array = self._array
        frames = np.full(batch.frames.shape, np.nan, array.dtype)
        units = np.full(batch.frames.shape, np.nan, np.float32)
        weights = np.zeros(batch.frames.shape, np.float32)
        remarks: list[str] = []
        of_frame = array.sensor[batch.frame_indices]
        for sensor in np.unique(of_frame):
            rows = np.flatnonzero(of_frame == sensor)
            if not np.isfinite(batch.frames[rows]).any():
                # It looks away; the others go on.
                continue
            own = self._prepared_of(batch, rows, int(sensor))
            remarks += self._remarks.new(
                Remark(f'{sensor} {one.kind}', f'sensor {sensor}: {one.text}', one.frames)
                for one in own.remarks)
            height, width = array.shapes[sensor]
            frames[rows, :height, :width] = own.frames
            plain = own.weights is None
            weights[rows, :height, :width] = 1.0 if plain else own.weights
            units[rows, :height, :width] = array.noise_sigmas[sensor] * (
                own.noise_level if plain else own.unit)
        if not weights.any():
            raise DataError(f'no pixel of the {len(batch)} frames is finite')
        return FrameBatch(frames, batch.stamps, batch.frame_indices), weights, units, remarks

    def _prepared_of(self, batch: FrameBatch, rows: NDArray, sensor: int) -> PreparedBatch:
        """Return the frames of one sensor, prepared with what is known of its pixels."""
        array = self._array
        height, width = array.shapes[sensor]
        own = FrameBatch(
            batch.frames[rows, :height, :width] / np.float32(array.noise_sigmas[sensor]),
            batch.stamps[rows], array.row[batch.frame_indices[rows]])
        options = self._options.replace(variance=array.variances[sensor],
                                        mask=array.masks[sensor])
        return prepare(own, options, array.measurement.psfs[sensor].width_px)

    def _on_plane(self, found: FoundTrajectory, units: NDArray, batch: FrameBatch) -> Trajectory:
        """Return a trajectory on the plane, amplitudes in the units of each frame's sensor."""
        array = self._array
        maps = array.measurement.maps[batch.frame_indices]
        at = np.rint(geometry.apply(maps, found.positions))
        amplitudes = np.full(len(at), np.nan, found.amplitudes.dtype)
        for t, (x, y) in enumerate(at):
            height, width = array.shapes[array.sensor[batch.frame_indices[t]]]
            if 0 <= x < width and 0 <= y < height:
                amplitudes[t] = found.amplitudes[t] * units[t, int(y), int(x)]
        present = np.isfinite(found.positions[:, 0])
        positions = found.positions + array.origin
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
