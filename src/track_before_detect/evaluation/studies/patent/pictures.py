"""Pictures of the suite ``patent``: six panels per figure, and the shares of all methods."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine import pictures
from track_before_detect.evaluation.engine.quantities import Quantity
from track_before_detect.evaluation.studies.patent.figures import (
    COMBINATORIAL,
    CONTINUATION,
    CONVEX,
    Figure,
    GREEDY,
)
from track_before_detect.evaluation.studies.patent.scenes import Scene
from track_before_detect.models.measurement.psf import GaussianPsf

COLOURS = {CONVEX: pictures.GREY, CONTINUATION: pictures.BLUE,
           COMBINATORIAL: pictures.GREEN, GREEDY: pictures.RED}
_TRUTH_COLOUR, _SIGNAL_COLOUR = 'black', '#4d4d4d'
# What is shown beside the targets of a batch.
_MARGIN_PX = 20.0
_TRUTH_STYLE = {'color': 'white', 'linewidth': 1.0, 'linestyle': '--'}

# Positions (K, T) and amplitudes (K, T) by method.
Found = Mapping[str, tuple[NDArray, NDArray]]


def draw_figure(canvas: Any, figure: Figure, scene: Scene, found: Found,
                threshold: float) -> None:
    """Draw panels A-F of one figure: a scene, and what was found in it."""
    canvas.set_size_inches(12, 6.5)
    canvas.suptitle(f'Figure {figure.number}: {figure.title}')
    psf = GaussianPsf(figure.options['psf_sigma_px'])
    panels = canvas.subplots(2, 3, sharex=True).ravel()
    draw = _draw_frame if len(scene.measured) == 1 else _draw_batch
    draw(panels, scene, found, threshold, _matched_filter(scene.measured[:, 0], psf))


def draw_shares(canvas: Any, shares: Mapping[str, Mapping[str, Quantity]]) -> None:
    """Draw share and interval by criterion and method."""
    canvas.set_size_inches(10, 1.5 + 0.42 * len(shares))
    axes = canvas.subplots()
    methods = list(next(iter(shares.values())))
    for number, method in enumerate(methods):
        at = np.arange(len(shares)) + 0.2 * (number - 0.5 * (len(methods) - 1))
        share, low, high = (100 * np.array([
            (one[method].value, one[method].low, one[method].high) for one in shares.values()])).T
        axes.barh(at, share, 0.18, color=COLOURS[method], label=method)
        axes.errorbar(share, at, xerr=[np.maximum(share - low, 0), np.maximum(high - share, 0)],
                      fmt='none', ecolor='black', elinewidth=0.8)
    axes.set_yticks(np.arange(len(shares)), list(shares))
    axes.set(ylim=(len(shares) - 0.5, -0.5), xlim=(0, 100),
             xlabel='share of scenes [%], with 95 % intervals')
    pictures.tidy([axes], grid=False)
    pictures.legend_above(canvas, len(methods))


def _matched_filter(frames: NDArray, psf: GaussianPsf) -> NDArray[np.float64]:
    """Return the matched filter statistic on the pixels, shape (T, W)."""
    taps = psf.taps(0.0)
    norm = np.sqrt(np.convolve(np.ones(frames.shape[1]), taps**2, 'same'))
    return np.array([np.convolve(frame, taps, 'same') for frame in frames]) / norm


def _draw_frame(panels: NDArray, scene: Scene, found: Found, threshold: float,
                statistic: NDArray) -> None:
    """Draw one frame: strength over position."""
    positions = scene.positions[:, 0]
    curves = ((scene.received[0], 'B  received'), (scene.measured[0, 0], 'C  measured'),
              (statistic[0], 'D  matched filter and threshold'))
    _stems(panels[0], positions, scene.snrs, _TRUTH_COLOUR)
    panels[0].set_title('A  targets', loc='left')
    panels[0].set_ylabel('amplitude')
    for axes, (curve, title) in zip(panels[1:4], curves, strict=True):
        axes.plot(curve, color=_SIGNAL_COLOUR, linewidth=1.0)
        axes.set_title(title, loc='left')
    panels[1].set_ylabel('signal')
    panels[2].set_ylabel('signal')
    panels[3].set_ylabel('statistic')
    _leave_room(panels[3])
    panels[3].axhline(threshold, color=COLOURS[GREEDY], linestyle='--',
                      label=f'threshold {threshold:g}')
    panels[3].legend(loc='upper right', fontsize='small')
    for axes, title, methods in _detection_panels(panels):
        _stems(axes, positions, scene.snrs, 'lightgrey', marker='', linewidth=4.0, label='truth')
        for method in methods:
            at, amplitudes = found[method]
            _stems(axes, at[:, 0], amplitudes[:, 0], COLOURS[method],
                   label=f'{method}: {len(at)}', marker='x' if method == CONVEX else 'o')
        axes.set_title(title, loc='left')
        axes.set_ylabel('amplitude')
        _leave_room(axes)
        axes.legend(loc='upper right', fontsize='small')
    pictures.tidy(panels, grid=False)
    for axes in panels[3:]:
        axes.set_xlabel('position [px]')


def _leave_room(axes: Any) -> None:
    """Make room for a legend above the curves."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.4 * (high - low))


def _stems(axes: Any, at: NDArray, heights: NDArray, colour: str, marker: str = 'o',
           label: str | None = None, linewidth: float = 1.5) -> None:
    axes.vlines(at, 0, heights, color=colour, linewidth=linewidth,
                label=label if not marker else None)
    if marker:
        axes.plot(at, heights, marker, color=colour, label=label)


def _draw_batch(panels: NDArray, scene: Scene, found: Found, threshold: float,
                statistic: NDArray) -> None:
    """Draw a batch: position over time as an image."""
    frames = np.arange(len(scene.measured))
    low = max(scene.positions.min() - _MARGIN_PX, -0.5)
    high = min(scene.positions.max() + _MARGIN_PX, scene.received.shape[1] - 0.5)
    images: tuple[tuple[NDArray, str], ...] = (
        (scene.received, 'A  targets'), (scene.measured[:, 0], 'B  measured'),
        (statistic, 'C  matched filter'), (statistic, 'D  matched filter and targets'))
    for axes, (image, title) in zip(panels[:4], images, strict=True):
        axes.imshow(image.T, origin='lower', aspect='auto', cmap='viridis')
        axes.set_title(title, loc='left')
    for axes in (panels[0], panels[3]):
        for path in scene.positions:
            axes.plot(frames, path, **_TRUTH_STYLE)
    for axes, title, methods in _detection_panels(panels):
        for number, path in enumerate(scene.positions):
            axes.plot(frames, path, color='lightgrey', linewidth=4.0,
                      label=None if number else 'truth')
        for method in methods:
            for number, path in enumerate(found[method][0]):
                axes.plot(frames, path, color=COLOURS[method],
                          linewidth=0.8 if method == CONVEX else 1.6,
                          label=None if number else f'{method}: {len(found[method][0])}')
        axes.set_title(f'{title}, threshold {threshold:.2f}', loc='left')
        axes.legend(loc='best', fontsize='small', ncols=3)
        axes.grid(alpha=0.3)
    for axes in panels:
        axes.set_ylim(low, high)
    for axes in panels[::3]:
        axes.set_ylabel('position [px]')
    for axes in panels[3:]:
        axes.set_xlabel('frame')


def _detection_panels(panels: NDArray) -> tuple[tuple[Any, str, tuple[str, ...]], ...]:
    return ((panels[4], 'E  convex', (CONVEX, CONTINUATION)), (panels[5], 'F  greedy', (GREEDY,)))
