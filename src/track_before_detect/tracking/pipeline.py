"""Frames in, trajectories out: what the node and the command run, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
import logging

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.checks import checked_stamps
from track_before_detect.errors import DataError
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.per_frame import KeptFrames
from track_before_detect.preprocess.prepare import noise_of_one, pictures, PreparedBatch
from track_before_detect.preprocess.robust import median_deviation
from track_before_detect.solvers.batch_detector import (
    BatchDetector,
    BatchResult,
    FoundTrajectory,
)
from track_before_detect.solvers.clutter.detector import MAY_CARRY_ON, SEPARATION
from track_before_detect.solvers.detectors import make_detector
from track_before_detect.solvers.search.coarse_to_fine import search_once
from track_before_detect.tracking.batcher import hop_of
from track_before_detect.tracking.compilation import LABEL, searches_cells, told_of_compiling
from track_before_detect.tracking.previous_batch import PreviousBatches
from track_before_detect.tracking.stitcher import not_carried
from track_before_detect.types import (
    DetectionResult,
    FrameBatch,
    Progress,
    Remark,
    Trajectory,
    worst_status,
)

_LOG = logging.getLogger(__name__)
# A spread of the pixels above which noise=none must be an oversight.
MOST_SPREAD = 3.0
# Median interval of frames beyond which stamps cannot be seconds.
INTERVALS_S = (1e-12, 1e12)

# Beyond these, counted once for each background, one is taken off only when it is searched beside:
# frames without it take several times the memory of those that came.
MOST_PIXELS_AHEAD = 2**23

@dataclass(frozen=True)
class Searched:
    """A batch as it came, prepared beside one background, and what was found there."""

    batch: FrameBatch
    prepared: PreparedBatch
    result: BatchResult
    options: DetectorOptions
    background: str


@dataclass(frozen=True)
class Unlinked:
    """What was found in a batch, before it is known who is who.

    Attributes
    ----------
    result : DetectionResult
        Its trajectories have the id 0.
    remarks : tuple of Remark
        From which those of the result were made, as far as they said something new.
    period_px : float or None
        Columns after which the frames begin again.
    """

    result: DetectionResult
    remarks: Sequence[Remark]
    period_px: float | None


Observer = Callable[[Searched], None]
# Finds the trajectories of a batch that is prepared, once; told of progress.
BatchSearch = Callable[[Progress | None], DetectionResult]
# What is searched instead of a background that is not one.
BACKGROUNDS = {'either': ('temporal_median', 'spatial_median')}


def detector_for(options: DetectorOptions, part: tuple[int, int] = (0, 1)) -> BatchDetector:
    """Return the detector that searches beside each background, at its share of the rate.

    ``part`` is of the tiles, see :class:`TiledDetector`.
    """
    return make_detector(options.replace(
        false_alarm_rate=options.false_alarm_rate / len(_backgrounds(options))), part)


def _backgrounds(options: DetectorOptions) -> tuple[str, ...]:
    """Return the backgrounds beside each of which frames are searched."""
    return BACKGROUNDS.get(options.background, (options.background,))


def period_of(options: DetectorOptions, width: int) -> int | None:
    """Return the columns after which frames of a width begin again, None where they end."""
    wraps = options.motion_model == 'range_bearing' or options.doppler_ambiguities > 0
    return width if wraps else None


class TrackingPipeline:
    """Preprocessing, detection and identities over successive batches.

    Parameters
    ----------
    options : DetectorOptions
        What to look for and how.
    earlier : TrackingPipeline, optional
        Pipeline that this one takes over from, with the identities it knows.
    detector : BatchDetector, optional
        The detector that the options name unless given.
    observe : callable, optional
        Shown each batch that was searched, once for each background.
    """

    stamps_may_repeat = False

    def __init__(self, options: DetectorOptions, earlier: TrackingPipeline | None = None,
                 detector: BatchDetector | None = None, observe: Observer | None = None):
        self._options = options
        self._observe = observe
        self._backgrounds = _backgrounds(options)
        self._detector = detector or detector_for(options)
        self._before: PreviousBatches = PreviousBatches(
            psf_of(options).width_px, earlier._before if earlier else None)
        length, hop = options.batch_length or 0, options.hop
        self._kept = KeptFrames(max(length - (hop or hop_of(length)), 0))
        self._scale_is_known = False

    def warm_up(self, shape: tuple[int, int], interval_s: float, n_frames: int,
                progress: Progress | None = None) -> float:
        """Compile every kernel and calibrate the threshold before the first batch.

        Parameters
        ----------
        shape : tuple of int
            (H, W) of the frames.
        interval_s : float
            Seconds between frames.
        n_frames : int
            Frames of a batch.
        progress : callable, optional
            Called with a label and the share done, 0 to 1.

        Returns
        -------
        float
            The threshold on the statistic.
        """
        self.compile(progress)
        return self._detector.threshold(interval_s * np.arange(n_frames), shape, progress)

    def compile(self, progress: Progress | None = None) -> None:
        """Run every kernel once, on a target bright enough to pass through all stages."""
        if progress is not None:
            progress(LABEL, 0.0)
        options = self._options.replace(
            threshold=None if self._options.calibration == 'clutter' else 8.0,
            psf_sigma_px=1.0, max_speed_px_s=None, max_acceleration_px_s2=None, variance=None,
            mask=None, doppler_ambiguities=0, exposure_s=min(self._options.exposure_s, 1.0))
        # Where columns go round a wide PSF needs as many.
        width = max(24, 2 * psf_of(options).half_width + 1)
        # So high that not all is searched anew when a target in clutter is set aside.
        height = 400 if options.calibration == 'clutter' else 24
        frames = np.random.default_rng(0).standard_normal((16, height, width)).astype(
            np.float32)
        frames[:, 10:13, 10:13] += 8
        if options.amplitudes == 'complex':
            frames = frames.astype(np.complex64)
        batch = FrameBatch.of(frames, np.arange(16.0))
        # Either compiles what constant does, and what fluctuating does.
        kinds = {'either': ('fluctuating', 'constant')}.get(
            options.amplitude_model, (options.amplitude_model,))
        detectors = [make_detector(options.replace(amplitude_model=kind)) for kind in kinds]
        with told_of_compiling(progress, self._options):
            for detector in detectors:
                detector.detect(batch)
            frames[:, 0, 0] = np.nan
            for detector in detectors:
                detector.detect(batch)
            if searches_cells(self._options):
                search_once()
            self._prepare_once(options, frames.dtype)
        if progress is not None:
            progress(LABEL, 1.0)

    def _prepare_once(self, options: DetectorOptions, kind: np.dtype) -> None:
        """Run every kernel of preprocessing, on a scene that moves by a pixel per frame."""
        rng = np.random.default_rng(0)
        scene = rng.normal(100, 10, (48, 56))
        frames = np.stack([scene[:, t:t + 48] + rng.normal(size=(48, 48)) for t in range(8)])
        batch = FrameBatch.of(frames.astype(kind), np.arange(8.0))
        seen = pictures(batch, options, options.psf_sigma_px)
        for background in self._backgrounds:
            noise_of_one(seen, batch, options.replace(background=background),
                         options.psf_sigma_px)

    def process(self, batch: FrameBatch, progress: Progress | None = None) -> DetectionResult:
        """Find the trajectories of a batch.

        Parameters
        ----------
        batch : FrameBatch
            Frames as they came.
        progress : callable, optional
            Told of a calibration, and of the search while it lasts.

        Returns
        -------
        DetectionResult
            Positions in pixels of the original frames, amplitudes in units of the input, ids as
            in the batches before.
        """
        return self.prepare(batch, progress)(progress)

    def prepare(self, batch: FrameBatch, progress: Progress | None = None) -> BatchSearch:
        """Prepare a batch, and return what finds its trajectories.

        Batches may be prepared in one thread while they are searched in another, in the same
        order.

        Parameters
        ----------
        batch : FrameBatch
            Frames as they came.
        progress : callable, optional
            Told of what is compiled.
        """
        search = self.prepare_unlinked(batch, progress)

        def linked(progress: Progress | None = None) -> DetectionResult:
            return self.link(search(progress))
        return linked

    def prepare_unlinked(self, batch: FrameBatch, progress: Progress | None = None,
                         ) -> Callable[[Progress | None], Unlinked]:
        """Prepare a batch, and return what finds its trajectories for :meth:`link`."""
        _check(batch)
        width_px = psf_of(self._options).width_px
        with told_of_compiling(progress, self._options):
            seen = pictures(batch, self._options, width_px, self._kept)
            steps: list[Callable[[], PreparedBatch]] = [cache(partial(
                noise_of_one, seen, batch, self._options.replace(background=background),
                width_px, self._kept)) for background in self._backgrounds]
            for step in steps[:MOST_PIXELS_AHEAD // max(batch.frames.size, 1)]:
                step()
        return partial(self._find, batch, steps)

    def _find(self, batch: FrameBatch, steps: list[Callable[[], PreparedBatch]],
              progress: Progress | None = None) -> Unlinked:
        """Find the trajectories of a batch, which the steps prepare beside each background."""
        with told_of_compiling(progress, self._options):
            # What was searched is let go.
            searched = [self._search(batch, steps.pop(0)(), background, progress)
                        for background in self._backgrounds]
        results = [result for result, _ in searched]
        found = [trajectory for result in results for trajectory in result.trajectories]
        if len(results) > 1:
            found = _strongest_of_near(found, SEPARATION * psf_of(self._options).width_px)
        status = worst_status(result.status for result in results)
        worst = next(result for result in results if result.status == status)
        return Unlinked(
            replace(worst, trajectories=found,
                    rejected=[one for result in results for one in result.rejected],
                    best_statistic=float(np.fmax.reduce(
                        [result.best_statistic for result in results])),
                    remarks=[remark for result in results for remark in result.remarks]),
            [remark for _, remarks in searched for remark in remarks],
            period_of(self._options, batch.frames.shape[2]))

    def link(self, found: Unlinked, elsewhere: bool = False) -> DetectionResult:
        """Return what was found in the batch after the one before, with ids.

        ``elsewhere`` is whether another pipeline found it, which does not know what this one said.
        """
        result = found.result
        if elsewhere:
            result = replace(result, remarks=self._before.remarks.new(found.remarks))
        trajectories = self._before.link(
            result.trajectories, found.period_px, _may_carry_on(result.rejected))
        return replace(result, trajectories=trajectories,
                       rejected=not_carried(result.rejected, trajectories))

    def begin_afresh(self) -> None:
        """Search the next batch as if it were the first; identities go on."""
        self._before.begin_afresh()

    def thresholds(self, stamps: Iterable[NDArray], shape: tuple[int, int],
                   progress: Progress | None = None) -> None:
        """Calibrate the thresholds of batches (H, W) with these stamps, one after the other."""
        for one in stamps:
            self._detector.threshold(one, shape, progress)

    def carried_on(self, known: list[Trajectory], weaker: list[Trajectory]) -> list[Trajectory]:
        """Return the rejected candidates that carry on trajectories; see :class:`Stitcher`."""
        return self._before.stitcher.carried_on(known, _may_carry_on(weaker))

    def _search(self, batch: FrameBatch, prepared: PreparedBatch, background: str,
                progress: Progress | None) -> tuple[DetectionResult, list[Remark]]:
        """Find the trajectories beside one background, without ids, and all remarks."""
        noticed = list(prepared.remarks)
        remarks = self._before.remarks.new(noticed)
        if not np.isfinite(prepared.frames).any():
            return DetectionResult([], 0.0, remarks=remarks), noticed
        middle = prepared.frames[len(batch) // 2]
        self._check_scale(middle)
        earlier = self._before.paths(prepared.frame_indices, prepared.maps)
        result = self._detector.detect(
            FrameBatch(prepared.frames, prepared.stamps, prepared.frame_indices, prepared.scene),
            prepared.weights, earlier, progress)
        if self._observe is not None:
            self._observe(Searched(batch, prepared, result, self._options, background))
        weighted = prepared.weights is not None
        unit = np.array(prepared.unit) if weighted else prepared.noise_level
        period = period_of(self._options, prepared.frames.shape[2])
        found, rejected = (
            [trajectory for one in ones if np.isfinite(
                (trajectory := _in_original_frames(one, prepared, unit, period)).positions).any()]
            for ones in (result.found, result.rejected))
        if result.status == 'not_noise':
            words = ('frames pass the threshold nearly everywhere, as noise never does, and are '
                     f'not searched: {self._what_to_set(middle)}')
            noticed.append(Remark('not_noise', words))
            remarks += self._before.remarks.new(noticed[-1:])
        return DetectionResult(found, result.threshold, result.status, result.history, result.gap,
                               result.best_statistic, rejected=rejected, remarks=remarks,
                               threshold_source=self._detector.threshold_source), noticed

    def reset(self) -> None:
        """Forget identities and earlier batches."""
        self._before.reset()

    def _check_scale(self, frame: NDArray) -> None:
        """Say once when frames taken to have a noise of one cannot have."""
        if self._scale_is_known:
            return
        self._scale_is_known = True
        middle, spread = _middle_and_spread(frame)
        if max(spread, abs(middle)) > MOST_SPREAD:
            _LOG.warning(
                'the pixels have a median of %.3g and a spread of %.3g, where background=%s and '
                'noise=%s should leave a median of 0 and a spread of 1: %s', middle, spread,
                self._options.background, self._options.noise, self._what_to_set(frame))

    def _what_to_set(self, frame: NDArray) -> str:
        """Return which option to turn for a prepared frame that is no unit noise."""
        options, wanted = self._options, []
        middle, spread = _middle_and_spread(frame)
        scaled = options.noise != 'none'
        if options.background == 'none' and (scaled or abs(middle) > 0.5 * spread):
            wanted.append('background=temporal_median')
        if not scaled:
            wanted.append('noise=robust')
        return f'set {" and ".join(wanted) or "noise=map, or a larger threshold"}'


def _may_carry_on(rejected: list[Trajectory]) -> list[Trajectory]:
    """Return the candidates that are targets where they carry one on."""
    return [trajectory for trajectory in rejected if trajectory.reason in MAY_CARRY_ON]


def _middle_and_spread(frame: NDArray) -> tuple[float, float]:
    """Return the median and the robust deviation of pixels, of the real part of complex ones."""
    pixels = frame[np.isfinite(frame)]
    if not len(pixels):
        return 0.0, 0.0
    if np.iscomplexobj(pixels):
        pixels = pixels.real * 2**0.5
    middle = float(np.median(pixels))
    return middle, median_deviation(pixels - middle)


def _check(batch: FrameBatch) -> None:
    """Refuse stamps that cannot be seconds, before anything is computed."""
    stamps = checked_stamps(batch.stamps, len(batch.frames))
    if len(stamps) > 1:
        interval = float(np.median(np.diff(stamps)))
        least, most = INTERVALS_S
        if not least <= interval <= most:
            raise DataError(f'stamps must be {least:g} to {most:g} s apart, got a median '
                            f'interval of {interval:g} s')


def _in_original_frames(found: FoundTrajectory, prepared: PreparedBatch,
                        unit: NDArray, period: int | None) -> Trajectory:
    """Return a trajectory in the pixels of the frames as they came, and in their units.

    ``unit`` (T, H, W), or of a shape that broadcasts to it, is the unit of the amplitudes; the
    columns begin again after ``period``, if not None.
    """
    positions = geometry.apply(prepared.maps, found.positions)
    n_frames, height, width = prepared.frames.shape
    level = np.broadcast_to(unit, (n_frames, height, width))
    present = np.isfinite(positions[:, 0])
    nearest = np.rint(np.where(present[:, None], positions, 0.0))
    x, y = np.clip(nearest, 0, (width - 1, height - 1)).astype(int).T
    # Where the unit of a pixel is not known, because it is masked, the amplitude is not.
    amplitudes = found.amplitudes * level[np.arange(n_frames), y, x]
    velocity = np.where(present[:, None], np.zeros(2), np.nan)
    if present.sum() > 1:
        moved = positions[present]
        if period is not None:
            moved[:, 0] = np.unwrap(moved[:, 0], period=period)
        velocity[present] = np.gradient(moved, prepared.stamps[present], axis=0)
    # A path on the registered plane may leave the view of a frame; it is absent from that frame,
    # and from those that show another scene.
    inside = (positions >= -0.5) & (positions <= [width - 0.5, height - 0.5])
    outside = ~inside.all(axis=1) | prepared.elsewhere
    positions[outside] = np.nan
    velocity[outside] = np.nan
    amplitudes[outside] = np.nan
    covariance = np.full((n_frames, 2, 2), np.nan)
    if found.covariance is not None:
        slopes = geometry.slopes(prepared.maps, found.positions)[~outside]
        covariance[~outside] = slopes @ found.covariance[~outside] @ slopes.swapaxes(1, 2)
    return Trajectory(0, positions, amplitudes, velocity, prepared.stamps, prepared.frame_indices,
                      found.statistic, found.snr, found.reason, covariance)


def _strongest_of_near(trajectories: list[Trajectory], distance_px: float) -> list[Trajectory]:
    """Return all trajectories but those that lie on one of a larger statistic."""
    kept: list[Trajectory] = []
    for trajectory in sorted(trajectories, key=lambda trajectory: -trajectory.statistic):
        between = [np.hypot(*(trajectory.positions - other.positions).T) for other in kept]
        if not any(np.nanmedian(distances) < distance_px for distances in between):
            kept.append(trajectory)
    return kept
