"""Pictures of the suites ``ring-single`` and ``ring-multi``, as the paper arranges them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

ORDERS = ('cfo', 'cso', 'mff')
_COLOURS = {'cfo': '#8c8c8c', 'cso': '#1f77b4', 'mff': '#d62728'}
_STYLES = ('-', '--', ':')
_BY_METHOD = Mapping[str, NDArray]


def draw_single(canvas: Any, means: _BY_METHOD, half_widths: _BY_METHOD, snrs: Sequence[float],
                lengths: Sequence[int], stated: Mapping[str, float]) -> None:
    """Draw Figure 6: DP, DPR and their difference, by case.

    Parameters
    ----------
    canvas : matplotlib Figure
    means, half_widths : mapping
        By method, shape (C, L, S).
    snrs, lengths : sequence
        What S and L stand for.
    stated : mapping
        By order, what the paper says of the best P_d of its plain form at the first SNR; drawn in
        the case in which ours is best.
    """
    titles = [f'test case {case}: {what}' for case, what in enumerate(
        ('line, v_max = 2', 'line, v_max = 1', 'arc, v_max = 1'), 1)]
    panels = _probabilities(canvas, titles, snrs)
    for case, column in enumerate(panels.T):
        # The longest sequence is drawn solid.
        for number, style in zip(reversed(range(len(lengths))), _STYLES):
            for order in ORDERS:
                _draw_curves(column, order, means, half_widths, (case, number), snrs, style)
    for order, value in stated.items():
        ours = means[f'{order}_dp'][..., 0].max(axis=1)
        panels[0, ours.argmax()].plot(snrs[0], 100 * value, 'o', markersize=8, markeredgewidth=1.8,
                                markerfacecolor='white', markeredgecolor=_COLOURS[order],
                                clip_on=False, zorder=5)
    handles = [*(_handle(panels[0, 0], _COLOURS[order], '-', order.upper()) for order in ORDERS),
               *(_handle(panels[0, 0], 'black', style, f'N = {length}')
                 for length, style in zip(reversed(lengths), _STYLES)),
               panels[0, 0].plot([], [], 'o', markersize=8, markeredgewidth=1.8, color='black',
                                 markerfacecolor='white', label='paper, best')[0]]
    canvas.legend(handles=handles, loc='outside upper center', ncols=7, frameon=False)


def draw_multi(canvas: Any, means: _BY_METHOD, half_widths: _BY_METHOD,
               snrs: Sequence[float]) -> None:
    """Draw Figure 9: DP, DPR and their difference, by case; arguments as above with L = 1."""
    panels = _probabilities(canvas, _multi_titles(), snrs)
    for case, column in enumerate(panels.T):
        for order in ORDERS:
            _draw_curves(column, order, means, half_widths, (case, 0), snrs, '-')
    handles = [_handle(panels[0, 0], _COLOURS[order], '-', order.upper()) for order in ORDERS]
    canvas.legend(handles=handles, loc='outside upper center', ncols=3, frameon=False)


def draw_false(canvas: Any, means: _BY_METHOD, half_widths: _BY_METHOD,
               snrs: Sequence[float]) -> None:
    """Draw Figure 10: the false alarm rate by case; arguments as above with L = 1."""
    canvas.set_size_inches(11, 4.2)
    panels = canvas.subplots(1, 3, sharey=True)
    for case, (axes, title) in enumerate(zip(panels, _multi_titles(), strict=True)):
        for order in ORDERS:
            for form, style in (('dp', '--'), ('dpr', '-')):
                method = f'{order}_{form}'
                _band(axes, snrs, 1e6 * means[method][case, 0],
                      1e6 * half_widths[method][case, 0], _COLOURS[order], style)
        axes.set_title(title, fontsize='medium')
        axes.set_xlabel('SNR')
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)
    # Not before all panels are drawn: they share the scale.
    panels[0].set_ylim(bottom=0)
    panels[0].set_ylabel('false alarm rate P_f [1e-6]')
    handles = [*(_handle(panels[0], _COLOURS[order], '-', order.upper()) for order in ORDERS),
               _handle(panels[0], 'black', '--', 'DP'), _handle(panels[0], 'black', '-', 'DPR')]
    canvas.legend(handles=handles, loc='outside upper center', ncols=5, frameon=False)


def _multi_titles():
    return ['test case 1: two lines', 'test case 2: line and arc', 'test case 3: all three']


def _probabilities(canvas, titles, snrs):
    canvas.set_size_inches(11, 9)
    panels = canvas.subplots(3, 3, sharex=True, sharey='row')
    for axes, title in zip(panels[0], titles, strict=True):
        axes.set_title(title, fontsize='medium')
    for axes, label in zip(panels[:, 0], ('P_d of DP [%]', 'P_d of DPR [%]',
                                          'DPR minus DP [points]'), strict=True):
        axes.set_ylabel(label)
    for axes in panels[:2].ravel():
        axes.set_ylim(0, 100)
    for axes in panels[2]:
        axes.set_xlabel('SNR')
        axes.axhline(0, color='black', linewidth=0.6)
    for axes in panels.ravel():
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)
    panels[0, 0].set_xlim(min(snrs), max(snrs))
    return panels


def _draw_curves(column, order, means, half_widths, at, snrs, style):
    """Draw one method in the three panels of a case."""
    plain, ring = f'{order}_dp', f'{order}_dpr'
    for axes, method in zip(column[:2], (plain, ring), strict=True):
        _band(axes, snrs, 100 * means[method][at], 100 * half_widths[method][at],
              _COLOURS[order], style)
    column[2].plot(snrs, 100 * (means[ring][at] - means[plain][at]), style,
                   color=_COLOURS[order])


def _band(axes, snrs, mean, half_width, colour, style):
    axes.plot(snrs, mean, style, color=colour)
    axes.fill_between(snrs, np.maximum(mean - half_width, 0), mean + half_width, color=colour,
                      alpha=0.15, linewidth=0)


def _handle(axes, colour, style, label):
    return axes.plot([], [], style, color=colour, label=label)[0]
