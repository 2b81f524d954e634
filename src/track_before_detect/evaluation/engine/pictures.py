"""What the pictures of all reports share: the canvas, colours, bands and legends."""

from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import ArrayLike, NDArray

from track_before_detect.recordings.overlay import new_figure as empty_figure

BLUE, GREEN, GREY, RED = '#1f77b4', '#2ca02c', '#8c8c8c', '#d62728'


def new_figure() -> Any:
    """Return an empty matplotlib figure, or say how to install matplotlib."""
    return empty_figure(11, 4.5, 'the picture of a suite')


def tidy(panels: Iterable[Any], grid: bool = True) -> None:
    """Take the frame off the top and the right of axes, and draw a faint grid."""
    for axes in panels:
        if grid:
            axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)


def draw_band(axes: Any, x: ArrayLike, middle: ArrayLike, ends: Sequence[ArrayLike] | NDArray,
              colour: str, style: str, alpha: float) -> None:
    """Draw a curve and its intervals, from ``ends[0]`` to ``ends[1]``."""
    axes.plot(x, middle, style, color=colour)
    axes.fill_between(x, *ends, color=colour, alpha=alpha, linewidth=0)


def key(axes: Any, label: str, style: str = '-', **look: Any) -> Any:
    """Return an entry of a legend for what no single curve stands for."""
    return axes.plot([], [], style, label=label, **look)[0]


def legend_above(figure: Any, columns: int, keys: Sequence[Any] | None = None) -> None:
    """Put a legend above all panels, of all that has a label unless entries are given."""
    figure.legend(handles=keys, loc='outside upper center', ncols=columns, frameon=False)
