"""The pictures of an inspection, each drawn into axes of its own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.inspection.batch_facts import MOST_LAGS
from track_before_detect.inspection.observation import Observation
from track_before_detect.preprocess.resampling import warped_frames
from track_before_detect.preprocess.whiteness import matched_statistic
from track_before_detect.recordings.overlay import (
    colour_of,
    draw_frame,
    draw_label,
    new_figure,
    real_picture,
)
from track_before_detect.tracking.pipeline import Searched
from track_before_detect.types import Trajectory

# Of the noise, at the ends of the colours of a residual.
SHOWN_DEVIATIONS = 5.0
# Rejected candidates that are drawn.
MOST_DRAWN = 30
# Least motion in pixels per frame at the ends of its axis.
STILL_PX = 0.5
REASON_COLOURS = ('#ffd400', '#ff7f0e', '#e377c2', '#17becf', '#bcbd22', '#9467bd')
BLUE, ORANGE, GREY = '#1f77b4', '#d9541e', '#8c8c8c'


@dataclass(frozen=True)
class Panel:
    """One picture: its name, what it shows in a sentence, and what draws it into axes."""

    name: str
    caption: str
    draw: Callable[[Any], None]


def panels(observed: Observation, found: Sequence[Trajectory], rejected: Sequence[Trajectory],
           width_px: float) -> list[Panel]:
    """Return all pictures of an inspection.

    Parameters
    ----------
    observed : Observation
        Of a whole search.
    found, rejected : sequence of Trajectory
        Of the whole recording; the rejected ones numbered.
    width_px : float
        Standard deviation of a target in pixels.
    """
    first = observed.views[0]
    index = int(np.argmin(np.abs(first.batch.frame_indices - observed.middle)))
    number = int(first.batch.frame_indices[index])
    frame = real_picture(first.batch.frames[index])
    here = [one for one in rejected if number in one.frame_indices][:MOST_DRAWN]
    made = [
        Panel(f'Frame {number}', 'The frame as it came, with what was found (solid, with ids) and '
              'the candidates rejected around it (dashed, numbers of the table below).',
              lambda axes: _draw_frame(axes, frame, found, here)),
        Panel('Registered mean', 'The mean of the batch, each frame moved by the motion found: '
              'sharp where registration fits.', lambda axes: _draw_mean(axes, first)),
        Panel('Best path', 'The strongest path of each batch over its threshold; what lies above '
              'the line is a candidate.', lambda axes: _draw_strongest(axes, observed))]
    for view in observed.views:
        beside = f' ({view.background})' if len(observed.facts) > 1 else ''
        made += _views(view, index, beside, width_px)
    return [*made,
            Panel('Motion of the scene', 'By registration, in pixels per frame; crosses where it '
                  'is not credible.', lambda axes: _draw_motion(axes, observed)),
            Panel('Whiteness', 'How much the residual resembles itself some pixels or frames '
                  'further: near zero where it is white.',
                  lambda axes: _draw_whiteness(axes, observed))]


def png(drawn: Sequence[Panel], columns: int) -> bytes:
    """Return panels side by side as a PNG; titles only where there are several."""
    rows = -(-len(drawn) // columns)
    figure = new_figure(5.4 * columns, 4.2 * rows, 'tbd inspect')
    for number, panel in enumerate(drawn, 1):
        axes = figure.add_subplot(rows, columns, number)
        panel.draw(axes)
        if len(drawn) > 1:
            axes.set_title(panel.name)
    written = io.BytesIO()
    figure.savefig(written, format='png', dpi=120)
    return written.getvalue()


def _views(view: Searched, index: int, beside: str, width_px: float) -> list[Panel]:
    prepared = view.prepared
    residual = prepared.frames[index]
    matched = matched_statistic(residual, width_px)
    level = np.broadcast_to(prepared.noise_level, prepared.frames.shape)[index]
    return [
        Panel(f'Residual{beside}', 'What is searched, in units of the noise: no scene should '
              'show.', lambda axes: _draw_signed(axes, residual)),
        Panel(f'Noise map{beside}', 'Standard deviation that the frame was divided by, in units '
              'of the input.', lambda axes: _with_bar(axes, draw_frame(
                  axes, level.astype(float), colours='viridis'), 'noise')),
        Panel(f'Matched filter{beside}', 'The residual as a target is sought in it, one frame: '
              'deviation one in noise, the SNR where a target is.',
              lambda axes: _draw_signed(axes, matched))]


def _draw_frame(axes: Any, frame: NDArray, found: Sequence[Trajectory],
                rejected: Sequence[Trajectory]) -> None:
    draw_frame(axes, frame)
    reasons = list(dict.fromkeys(one.reason for one in rejected))
    for one in rejected:
        colour = REASON_COLOURS[reasons.index(one.reason) % len(REASON_COLOURS)]
        _draw_path(axes, one, colour, '--', 0.9)
        x, y = one.positions[np.isfinite(one.positions[:, 0])][-1]
        axes.annotate(str(one.id), (x, y), xytext=(3, -8), textcoords='offset points',
                      color=colour, fontsize=7, clip_on=True)
    for one in found:
        _draw_path(axes, one, tuple(part / 255 for part in colour_of(one.id)), '-', 1.6)
        draw_label(axes, one, one.positions)
    for number, reason in enumerate(reasons):
        axes.plot([], [], '--', color=REASON_COLOURS[number % len(REASON_COLOURS)], label=reason)
    if reasons:
        axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=8,
                    facecolor='#404040', labelcolor='white', framealpha=1)


def _draw_path(axes: Any, one: Trajectory, colour: Any, style: str, width: float) -> None:
    axes.plot(*one.positions.T, style, color=colour, linewidth=width)
    # What hovers is a point.
    axes.plot(*one.positions[np.isfinite(one.positions[:, 0])][-1], 'o', color=colour,
              markersize=3)


def _draw_mean(axes: Any, view: Searched) -> None:
    frames = real_picture(view.batch.frames).astype(np.float32)
    if view.prepared.registration is not None:
        frames = warped_frames(frames, view.prepared.registration.maps)
    known = np.isfinite(frames)
    mean = np.where(known, frames, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    draw_frame(axes, np.where(known.any(axis=0), mean, np.nan))


def _draw_signed(axes: Any, image: NDArray) -> None:
    shown = draw_frame(axes, real_picture(image), (-SHOWN_DEVIATIONS, SHOWN_DEVIATIONS), 'RdBu_r')
    axes.set_facecolor('#b0b0b0')
    _with_bar(axes, shown, 'in units of the noise')


def _with_bar(axes: Any, shown: Any, label: str) -> None:
    axes.figure.colorbar(shown, ax=axes, label=label, shrink=0.85)


def _draw_strongest(axes: Any, observed: Observation) -> None:
    at, strongest = observed.strongest()
    axes.axhline(1.0, color=ORANGE, linestyle='--', label='threshold')
    axes.plot(at, strongest, 'o-', color=BLUE, label='strongest path')
    frames = np.concatenate([fact.frames for fact in observed.all_facts()])
    axes.set(xlabel='frame', ylabel='statistic / threshold',
             xlim=(frames.min() - 0.5, frames.max() + 0.5))
    if np.nanmax(strongest, initial=1.0) > 10:
        axes.set_yscale('log')
    else:
        axes.set_ylim(0, 1.1 * float(np.nanmax(strongest, initial=1.0)))
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _draw_motion(axes: Any, observed: Observation) -> None:
    frames, motion, sure = observed.motion()
    axes.set(xlabel='frame', ylabel='motion [px per frame]')
    axes.grid(alpha=0.3)
    if not len(frames):
        axes.text(0.5, 0.5, 'not registered', transform=axes.transAxes, ha='center')
        return
    for along, name, colour in ((0, 'x', BLUE), (1, 'y', ORANGE)):
        axes.plot(frames, motion[:, along], color=colour, label=name, linewidth=1.2)
        axes.plot(frames[~sure], motion[~sure, along], 'x', color=colour)
    # What a still camera moves by is no motion.
    reach = max(STILL_PX, 1.1 * float(np.abs(motion).max()))
    axes.set_ylim(-reach, reach)
    axes.legend(fontsize=8)


def _draw_whiteness(axes: Any, observed: Observation) -> None:
    for background, style in zip(observed.facts, ('o-', 's--'), strict=False):
        beside = f', {background}' if len(observed.facts) > 1 else ''
        for name, colour, lags in zip(('space [px]', 'time [frames]'), (BLUE, ORANGE),
                                      observed.whiteness(background), strict=True):
            axes.plot(np.arange(len(lags)), lags, style, color=colour, label=name + beside)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(xlabel='shift', ylabel='autocorrelation', xlim=(-0.2, MOST_LAGS + 0.2),
             ylim=(-0.3, 1.05))
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
