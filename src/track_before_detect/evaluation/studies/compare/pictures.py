"""Pictures of the suite ``compare``."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine.pictures import GREY, tidy
from track_before_detect.evaluation.metrics.roc import Roc
from track_before_detect.evaluation.studies.compare.scenes import SCENES


def draw_found(figure: Any, means: NDArray, snrs: Sequence[float], names: Sequence[str],
               rate: float) -> None:
    """Draw the share of targets found, shape (scenes, SNRs, methods), as a table in colours."""
    figure.set_size_inches(11, 9)
    axes = figure.subplots()
    table = 100 * means.reshape(-1, len(names))
    image = axes.imshow(table, vmin=0, vmax=100, cmap='viridis', aspect='auto')
    for row, values in enumerate(table):
        for column, value in enumerate(values):
            axes.text(column, row, f'{value:.0f}', ha='center', va='center', fontsize='small',
                      color='black' if value > 60 else 'white',
                      fontweight='bold' if value >= values.max() else 'normal')
    axes.set_xticks(np.arange(len(names)), names, rotation=35, ha='left')
    axes.xaxis.tick_top()
    labels = [f'{scene}, SNR {snr:g}' for scene in SCENES for snr in snrs]
    axes.set_yticks(np.arange(len(labels)), labels)
    for edge in np.arange(len(snrs), len(labels), len(snrs)):
        axes.axhline(edge - 0.5, color='white', linewidth=2)
    axes.tick_params(length=0)
    figure.colorbar(image, label=f'targets found at {100 * rate:g} % false alarms [%]', shrink=0.6)


def draw_scenes(figure: Any) -> None:
    """Draw one example of each scene, from the first frame (dark) to the last."""
    figure.set_size_inches(11, 5.8)
    for number, (axes, (label, make)) in enumerate(
            zip(figure.subplots(2, 4).ravel(), SCENES.items(), strict=True)):
        paths = make(np.random.default_rng(number))
        low, high = np.nanmin(paths, axis=(0, 1)), np.nanmax(paths, axis=(0, 1))
        half = 0.5 * (high - low).max() + 4
        for path in paths:
            axes.scatter(*path.T, c=np.arange(len(path)), s=14, cmap='plasma')
        for limits, middle in ((axes.set_xlim, 0.5 * (low + high)[0]),
                               (axes.set_ylim, 0.5 * (low + high)[1])):
            limits(middle - half, middle + half)
        axes.invert_yaxis()
        axes.set_aspect('equal')
        axes.set_title(label, fontsize='medium')
        axes.grid(alpha=0.25)
    figure.supxlabel('x [px]', fontsize='medium')
    figure.supylabel('y [px]', fontsize='medium')


def draw_roc(figure: Any, curves: Mapping[str, Roc], rate: float, ours: str) -> None:
    """Draw targets found against false alarms while the threshold varies.

    ``rate`` is that of the other pictures; ``ours`` is drawn on top, with its interval.
    """
    figure.set_size_inches(11, 5.5)
    axes = figure.subplots()
    lowest = 100.0
    for number, (name, curve) in enumerate(curves.items()):
        alarmed = 100 * curve.alarmed_batches[:, 0]
        lowest = min([lowest, *alarmed[alarmed > 0]])
        alone = name == ours
        axes.step(alarmed, 100 * curve.detection_probability[:, 0], where='post', label=name,
                  color='black' if alone else f'C{number % 10}', zorder=3 if alone else 2,
                  linewidth=2.4 if alone else 1.4,
                  linestyle='-' if alone else ('-', '--')[number // 10 % 2])
        if alone:
            axes.fill_between(alarmed, *(100 * curve.detection_probability[:, 1:].T), step='post',
                              color='black', alpha=0.12, linewidth=0)
    axes.axvline(100 * rate, color=GREY, linewidth=0.8, linestyle=':')
    axes.set_xscale('log')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.set(xlim=(lowest, 100), ylim=(0, 100), xlabel='noise batches with a trajectory [%]',
             ylabel='targets found [%]')
    tidy([axes])
    figure.legend(loc='outside right upper', frameon=False, fontsize='small')
