"""Pictures of the suites ``ring-single`` and ``ring-multi``, as the paper arranges them.

``means`` and ``half_widths`` are by method, shape (C, L, S), with L = 1 for several targets.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.engine import pictures
from track_before_detect.evaluation.studies.ring.shares import ByMethod, ORDERS

_COLOURS = {'cfo': pictures.GREY, 'cso': pictures.BLUE, 'mff': pictures.RED}
_STYLES = ('-', '--', ':')
_STATED_MARK = {'markersize': 8, 'markeredgewidth': 1.8, 'markerfacecolor': 'white'}
_MULTI_TITLES = ('test case 1: two lines', 'test case 2: line and arc', 'test case 3: all three')


def draw_single(canvas: Any, means: ByMethod, half_widths: ByMethod, snrs: Sequence[float],
                lengths: Sequence[int], stated: Mapping[str, float]) -> None:
    """Draw Figure 6: DP, DPR and their difference, by case.

    ``stated`` is what the paper says, by order, of the best P_d of its plain form at the first
    SNR; drawn in the case in which ours is best.
    """
    titles = [f'test case {case}: {what}' for case, what in enumerate(
        ('line, v_max = 2', 'line, v_max = 1', 'arc, v_max = 1'), 1)]
    # The longest sequence is drawn solid.
    styles = dict(zip(reversed(range(len(lengths))), _STYLES, strict=False))
    panels = _draw_probabilities(canvas, titles, means, half_widths, snrs, styles)
    for order, value in stated.items():
        ours = means[f'{order}_dp'][..., 0].max(axis=1)
        panels[0, ours.argmax()].plot(snrs[0], 100 * value, 'o', markeredgecolor=_COLOURS[order],
                                      clip_on=False, zorder=5, **_STATED_MARK)
    pictures.legend_above(canvas, 7, [
        *_keys_of_orders(panels[0, 0]),
        *(pictures.key(panels[0, 0], f'N = {lengths[number]}', style, color='black')
          for number, style in styles.items()),
        pictures.key(panels[0, 0], 'paper, best', 'o', color='black', **_STATED_MARK)])


def draw_multi(canvas: Any, means: ByMethod, half_widths: ByMethod,
               snrs: Sequence[float]) -> None:
    """Draw Figure 9: DP, DPR and their difference, by case."""
    panels = _draw_probabilities(canvas, _MULTI_TITLES, means, half_widths, snrs, {0: '-'})
    pictures.legend_above(canvas, 3, _keys_of_orders(panels[0, 0]))


def draw_false(canvas: Any, means: ByMethod, half_widths: ByMethod,
               snrs: Sequence[float]) -> None:
    """Draw Figure 10: the false alarm rate by case."""
    canvas.set_size_inches(11, 4.2)
    panels = canvas.subplots(1, 3, sharey=True)
    styles = {'dp': '--', 'dpr': '-'}
    for case, (axes, title) in enumerate(zip(panels, _MULTI_TITLES, strict=True)):
        for order in ORDERS:
            for form, style in styles.items():
                method = f'{order}_{form}'
                _draw_mean(axes, snrs, 1e6 * means[method][case, 0],
                           1e6 * half_widths[method][case, 0], order, style)
        axes.set_title(title, fontsize='medium')
        axes.set_xlabel('SNR')
    pictures.tidy(panels)
    # Not before all panels are drawn: they share the scale.
    panels[0].set_ylim(bottom=0)
    panels[0].set_ylabel('false alarm rate P_f [1e-6]')
    pictures.legend_above(canvas, 5, [*_keys_of_orders(panels[0]), *(
        pictures.key(panels[0], form.upper(), style, color='black')
        for form, style in styles.items())])


def _draw_probabilities(canvas: Any, titles: Sequence[str], means: ByMethod,
                        half_widths: ByMethod, snrs: Sequence[float],
                        styles: Mapping[int, str]) -> NDArray:
    """Draw DP, DPR and their difference by case, each length in its style; return the panels."""
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
    pictures.tidy(panels.ravel())
    panels[0, 0].set_xlim(min(snrs), max(snrs))
    for case, column in enumerate(panels.T):
        for number, style in styles.items():
            for order in ORDERS:
                of_forms = [100 * means[f'{order}_{form}'][case, number] for form in ('dp', 'dpr')]
                for axes, form, mean in zip(column, ('dp', 'dpr'), of_forms, strict=False):
                    half_width = 100 * half_widths[f'{order}_{form}'][case, number]
                    _draw_mean(axes, snrs, mean, half_width, order, style)
                column[2].plot(snrs, of_forms[1] - of_forms[0], style, color=_COLOURS[order])
    return panels


def _draw_mean(axes: Any, snrs: Sequence[float], mean: NDArray, half_width: NDArray, order: str,
               style: str) -> None:
    ends = (np.maximum(mean - half_width, 0), mean + half_width)
    pictures.draw_band(axes, snrs, mean, ends, _COLOURS[order], style, 0.15)


def _keys_of_orders(axes: Any) -> list[Any]:
    return [pictures.key(axes, order.upper(), color=_COLOURS[order]) for order in ORDERS]
