"""A search on rerun, which fills in while it runs: frames, what is searched, what is found."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.inspection.batch_facts import strongest
from track_before_detect.option_models import psf_of
from track_before_detect.preprocess.whiteness import matched_statistic
from track_before_detect.recordings.overlay import (
    colour_of,
    contrast_limits,
    grey_picture,
    real_picture,
    trail,
)
from track_before_detect.recordings.recording import Recording
from track_before_detect.tracking.pipeline import Searched
from track_before_detect.types import Trajectory

# Black and white of what is searched, in deviations of the noise.
_SHOWN_DEVIATIONS = (-3.0, 8.0)
# Side of the box around a target, which shows in it.
_BOX_PX = 8.0
# Frames of a trajectory that are seen behind it.
_TRAIL = 25


class LiveView:
    """Shows the batches of a search as they come, and trajectories; times begin with the first.

    Parameters
    ----------
    stream : rerun.RecordingStream
        Where it is shown.
    truth : array, shape (N, 4), optional
        Rows [frame, id, x, y].
    """

    def __init__(self, stream: Any, truth: NDArray[np.float64] | None = None):
        self._stream = stream
        self._truth = truth
        # Of the frames, and beside each background: the number of the last frame shown.
        self._last: dict[str, int] = {}
        self._begun = float('nan')
        self._backgrounds: list[str] = []

    def __call__(self, searched: Searched) -> None:
        """Show the frames of a batch that were in none before, and how it ended."""
        batch, prepared, result = searched.batch, searched.prepared, searched.result
        background, width_px = searched.background, psf_of(searched.options).width_px
        if background not in self._backgrounds:
            self._backgrounds.append(background)
            self._stream.send_blueprint(_blueprint(self._backgrounds))
            for name in ('threshold', 'strongest_path'):
                # A point for each batch: a line would not show where there is but one.
                self._stream.log(f'statistic/{background}/{name}', _rerun().SeriesPoints(
                    marker_sizes=4.0), static=True)
        for k, number in enumerate(prepared.frame_indices.tolist()):
            self._set_frame(number, batch.stamps[k])
            if self._is_new('frame', number):
                self._show_frame(number, batch.frames[k])
            if self._is_new(background, number):
                residual = real_picture(prepared.frames[k])
                matched = real_picture(matched_statistic(prepared.frames[k], width_px))
                for name, image in (('residual', residual), ('matched_filter', matched)):
                    self._show(f'{name}/{background}',
                               grey_picture(image, *_SHOWN_DEVIATIONS))
        self._set_frame(int(batch.frame_indices[-1]), batch.stamps[-1])
        for name, value in (('threshold', result.threshold),
                            ('strongest_path', result.threshold * strongest(result))):
            if np.isfinite(value):
                self._stream.log(f'statistic/{background}/{name}', _rerun().Scalars(value))

    def show_frames(self, recording: Recording) -> None:
        """Show every frame by itself, where there is no search."""
        self._stream.send_blueprint(_blueprint([]))
        for number, stamp in enumerate(recording.stamps):
            self._set_frame(number, stamp)
            self._show_frame(number, recording[number])

    def show_trajectories(self, trajectories: Sequence[Trajectory], numbers: Iterable[int],
                          stamps: Iterable[float]) -> None:
        """Show where each trajectory is in frames of these numbers, and where it came from."""
        rerun = _rerun()
        for number, stamp in zip(numbers, stamps, strict=True):
            trails = [(one, *trail(one, number, _TRAIL)) for one in trajectories]
            here = [(one, points[-1] + 0.5) for one, points, is_here in trails if is_here]
            # Pixel centres are whole numbers here, and half a pixel further there.
            lines = [(one, points + 0.5) for one, points, _ in trails if len(points) > 1]
            self._set_frame(number, stamp)
            self._stream.log('frame/trajectories', rerun.Boxes2D(
                centers=np.reshape([point for _, point in here], (-1, 2)),
                half_sizes=np.full((len(here), 2), _BOX_PX / 2),
                colors=[colour_of(one.id) for one, _ in here],
                labels=[f'{one.id}  {one.snr:.1f}' for one, _ in here]))
            self._stream.log('frame/trails', rerun.LineStrips2D(
                [points for _, points in lines], colors=[colour_of(one.id) for one, _ in lines]))

    def _show_frame(self, number: int, frame: NDArray) -> None:
        frame = real_picture(frame)
        self._show('frame', grey_picture(frame, *contrast_limits(frame)))
        if self._truth is not None:
            self._stream.log('frame/truth', _rerun().Points2D(
                self._truth[self._truth[:, 0] == number, 2:] + 0.5, radii=0.5,
                colors=(255, 255, 255)))

    def _is_new(self, what: str, number: int) -> bool:
        if number <= self._last.get(what, -1):
            return False
        self._last[what] = number
        return True

    def _show(self, name: str, image: NDArray[np.uint8]) -> None:
        self._stream.log(name, _rerun().Image(image))

    def _set_frame(self, number: int, stamp: float) -> None:
        self._stream.set_time('frame', sequence=number)
        if np.isfinite(stamp):
            if np.isnan(self._begun):
                self._begun = float(stamp)
            self._stream.set_time('time', duration=float(stamp) - self._begun)


def _rerun() -> Any:
    import rerun
    return rerun


def _blueprint(backgrounds: list[str]) -> Any:
    """Return what is seen where: pictures side by side, the statistic over time below."""
    from rerun import blueprint

    names = ['frame', *(f'{what}/{background}' for background in backgrounds
                        for what in ('residual', 'matched_filter'))]
    pictures = blueprint.Grid(*(
        blueprint.Spatial2DView(origin=name, name=name) for name in names))
    return blueprint.Blueprint(blueprint.Vertical(
        pictures, blueprint.TimeSeriesView(origin='statistic', name='statistic'),
        row_shares=[3, 1]) if backgrounds else pictures, collapse_panels=True)
