"""Pictures of trajectories over a frame."""

from collections.abc import Sequence
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.atomic_files import atomic_path
from track_before_detect.errors import MissingExtraError
from track_before_detect.types import Trajectory

# Bright and distinct on a grey picture; a trajectory keeps its colour in every picture.
COLOURS = ((255, 89, 94), (54, 197, 240), (255, 202, 58), (138, 201, 38), (214, 122, 255),
           (255, 146, 43), (0, 212, 166), (255, 130, 190), (122, 156, 255), (200, 220, 120))
_STRETCH_SAMPLES = 65536
# More numbers than this cover what they name.
_MAX_LABELS_IN_PLANE = 60
_MAX_LABELS_OVER_TIME = 15


def colour_of(trajectory_id: int) -> tuple[int, int, int]:
    """Return the red, green and blue (0..255) of a trajectory."""
    return COLOURS[int(trajectory_id) % len(COLOURS)]


def contrast_limits(image: NDArray) -> tuple[float, float]:
    """Return the values to show as black and white; a few extreme pixels do not count.

    Parameters
    ----------
    image : array, shape (H, W)
        Real; pixels that are not finite do not count.

    Returns
    -------
    tuple of float
        ``low < high``, also for a flat image.
    """
    values = image.ravel()[::max(1, image.size // _STRETCH_SAMPLES)]
    values = values[np.isfinite(values)].astype(np.float64)
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, (0.5, 99.8))
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(low) + 0.5)


def render_overlay(frame: NDArray, trajectories: Sequence[Trajectory]) -> NDArray[np.uint8]:
    """Draw trajectories as coloured lines over a frame.

    Parameters
    ----------
    frame : array, shape (H, W)
        Real or complex (the magnitude is shown).
    trajectories : sequence of Trajectory
        Positions outside the frame are cut.

    Returns
    -------
    array of uint8, shape (H, W, 3)
        Red, green, blue.
    """
    image = real_picture(frame)
    picture = np.repeat(grey_picture(image, *contrast_limits(image))[..., None], 3, axis=2)
    for trajectory in trajectories:
        points = _line_pixels(_present(trajectory))
        inside = ((points >= 0) & (points < (image.shape[1], image.shape[0]))).all(axis=1)
        columns, rows = points[inside].T
        picture[rows, columns] = colour_of(trajectory.id)
    return picture


def grey_picture(image: NDArray, low: float, high: float) -> NDArray[np.uint8]:
    """Return a real image (H, W) as greys, 0 at ``low`` and below, 255 at ``high`` and above."""
    grey = image - image.dtype.type(low)
    grey *= image.dtype.type(255.0 / (high - low))
    # The order of these bounds turns NaN into black.
    np.fmin(np.fmax(grey, 0.0, out=grey), 255.0, out=grey)
    return grey.astype(np.uint8)


def write_overlay(path: str | os.PathLike, image: NDArray, trajectories: Sequence[Trajectory],
                  truth: NDArray | None = None, title: str = '',
                  frame_index: int | None = None) -> None:
    """Write a PNG: trajectories over a frame, and their x and y against the frame number.

    Parameters
    ----------
    path : path
        Ends with ``.png``.
    image : array, shape (H, W)
        Frame to draw on.
    trajectories : sequence of Trajectory
    truth : array, shape (N, 4), optional
        Rows [frame, id, x, y], drawn as thin dashed lines.
    title : str
    frame_index : int, optional
        Number of ``image`` in the recording; positions in that frame get a circle.
    """
    image = real_picture(image)
    height, width = image.shape
    picture_height = 6.5
    picture_width = float(np.clip(picture_height * width / height, 3.0, 11.0))
    figure = new_figure(picture_width + 5.5, picture_height + 0.7, 'an overlay picture')
    grid = figure.add_gridspec(2, 2, width_ratios=(picture_width, 4.5))
    plane = figure.add_subplot(grid[:, 0])
    over_x = figure.add_subplot(grid[0, 1])
    over_y = figure.add_subplot(grid[1, 1], sharex=over_x)
    draw_frame(plane, image)
    _draw_truth((plane, over_x, over_y), truth)
    for trajectory in trajectories:
        _draw_trajectory((plane, over_x, over_y), trajectory, frame_index)
    for trajectory in trajectories[:_MAX_LABELS_IN_PLANE]:
        draw_label(plane, trajectory, trajectory.positions)
    if len(trajectories) <= _MAX_LABELS_OVER_TIME:
        for trajectory in trajectories:
            for axes, axis in ((over_x, 0), (over_y, 1)):
                draw_label(axes, trajectory, np.column_stack(
                    [trajectory.frame_indices, trajectory.positions[:, axis]]))
    over_x.set(ylabel='x [px]')
    over_x.tick_params(labelbottom=False)
    over_y.set(ylabel='y [px]', xlabel='frame')
    for axes in (over_x, over_y):
        axes.grid(alpha=0.3)
        # Room for the labels at the right.
        axes.margins(x=0.08)
    if truth is not None and len(truth):
        handles, labels = over_x.get_legend_handles_labels()
        over_x.legend(handles, labels, fontsize='small', loc='best')
    shown = 'no trajectory' if not len(trajectories) else (
        f'{len(trajectories)} trajector{"y" if len(trajectories) == 1 else "ies"}')
    figure.suptitle(f'{title}: {shown}' if title else shown, fontsize='medium')
    with atomic_path(path) as partial:
        figure.savefig(partial, format='png', dpi=110)


def new_figure(width: float, height: float, what: str) -> Any:
    """Return an empty matplotlib figure, in inches, or say how to install matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError(
            f"{what} needs matplotlib: pip install 'track_before_detect[plots]'") from error
    figure = Figure(figsize=(width, height), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def draw_frame(plane: Any, image: NDArray, limits: tuple[float, float] | None = None,
               colours: str = 'gray') -> Any:
    """Show a real image (H, W) in axes; masked pixels stay empty.

    ``limits`` are the values at both ends of the ``colours``, those of most pixels unless given.
    """
    height, width = image.shape
    low, high = limits or contrast_limits(image)
    shown = plane.imshow(image, cmap=colours, vmin=low, vmax=high, interpolation='nearest')
    plane.set_facecolor('black')
    plane.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel='x [px]',
              ylabel='y [px]')
    return shown


def _draw_truth(axes: Sequence[Any], truth: NDArray | None) -> None:
    """Draw each true target as a thin dashed line."""
    if truth is None or not len(truth):
        return
    plane, over_x, over_y = axes
    label = 'truth'
    for target in np.unique(truth[:, 1]):
        rows = truth[truth[:, 1] == target]
        rows = rows[np.argsort(rows[:, 0], kind='stable')]
        # White shows on the frame, black on the paper of the other panels.
        plane.plot(rows[:, 2], rows[:, 3], color='white', linewidth=0.8, linestyle=(0, (4, 3)),
                   zorder=3)
        over_x.plot(rows[:, 0], rows[:, 2], color='black', linewidth=0.9,
                    linestyle=(0, (4, 3)), zorder=3, label=label)
        over_y.plot(rows[:, 0], rows[:, 3], color='black', linewidth=0.9,
                    linestyle=(0, (4, 3)), zorder=3)
        label = '_nolegend_'


def _draw_trajectory(axes: Sequence[Any], trajectory: Trajectory,
                     frame_index: int | None) -> None:
    """Draw one trajectory in all panels."""
    plane, over_x, over_y = axes
    colour = tuple(channel / 255 for channel in colour_of(trajectory.id))
    x, y = np.asarray(trajectory.positions, np.float64).T
    frames = trajectory.frame_indices
    present = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not len(present):
        return
    plane.plot(x, y, color=colour, linewidth=1.3, zorder=2)
    last = present[-1]
    plane.plot(x[last], y[last], marker='o', markersize=4, color=colour, markeredgecolor='black',
               markeredgewidth=0.6, zorder=4)
    here = present[frames[present] == frame_index] if frame_index is not None else []
    if len(here):
        plane.plot(x[here], y[here], marker='o', markersize=12, markerfacecolor='none',
                   markeredgecolor=colour, markeredgewidth=1.0, linestyle='none', zorder=4)
    over_x.plot(frames, x, color=colour, linewidth=1.6, zorder=2)
    over_y.plot(frames, y, color=colour, linewidth=1.6, zorder=2)
    if len(present) == 1:
        over_x.plot(frames[last], x[last], marker='.', color=colour)
        over_y.plot(frames[last], y[last], marker='.', color=colour)


def draw_label(axes: Any, trajectory: Trajectory, points: NDArray) -> None:
    """Write the number of a trajectory beside the last of its points (T, 2)."""
    from matplotlib.patheffects import withStroke

    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        axes.annotate(
            str(trajectory.id), points[-1], xytext=(4, 3), textcoords='offset points',
            color=tuple(channel / 255 for channel in colour_of(trajectory.id)), fontsize=9,
            fontweight='bold',
            path_effects=[withStroke(linewidth=2.2, foreground='black')], zorder=5,
            annotation_clip=True)


def real_picture(frame: NDArray) -> NDArray[np.floating]:
    """Return a real picture of a frame, in the floating-point type that holds its values."""
    frame = np.asarray(frame)
    if np.iscomplexobj(frame):
        return np.abs(frame)
    return frame.astype(np.result_type(frame.dtype, np.float32), copy=False)


def _present(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return the positions of a trajectory where it is present, shape (N, 2)."""
    positions = np.asarray(trajectory.positions, np.float64)
    return positions[np.isfinite(positions).all(axis=1)]


def trail(trajectory: Trajectory, index: int, length: int) -> tuple[NDArray[np.float64], bool]:
    """Return where a trajectory was in the last frames up to ``index``, and whether it is there.

    Parameters
    ----------
    trajectory : Trajectory
    index : int
        Number of a frame in the recording.
    length : int
        Frames that are looked at.

    Returns
    -------
    tuple of array, shape (N, 2), and bool
        Positions where it is present, and whether the last one is in frame ``index``.
    """
    first, last = np.searchsorted(trajectory.frame_indices, (index - length + 1, index + 1))
    present = np.flatnonzero(np.isfinite(trajectory.positions[first:last]).all(axis=1))
    is_there = len(present) > 0 and trajectory.frame_indices[first + present[-1]] == index
    return trajectory.positions[first + present], bool(is_there)


def _line_pixels(points: NDArray) -> NDArray[np.int64]:
    """Return whole pixels (column, row) on the straight lines between points."""
    if len(points) < 2:
        return np.rint(points).astype(np.int64).reshape(-1, 2)
    pieces = []
    for start, end in zip(points[:-1], points[1:], strict=True):
        n_steps = int(np.ceil(np.abs(end - start).max())) + 1
        pieces.append(np.linspace(start, end, n_steps + 1))
    return np.rint(np.concatenate(pieces)).astype(np.int64)
