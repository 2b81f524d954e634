"""A film of a recording with its trajectories, frame by frame: no more than a few are held."""

from collections import deque
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
import struct
from typing import Any

import numpy as np

from track_before_detect.errors import MissingExtraError, ParameterError
from track_before_detect.recordings.overlay import (
    colour_of,
    COLOURS,
    contrast_limits,
    grey_picture,
    real_picture,
    trail,
)
from track_before_detect.recordings.read_errors import read_errors
from track_before_detect.recordings.recording import Recording
from track_before_detect.timestamps import increasing_frames
from track_before_detect.types import Progress, Trajectory

# Package and extra that each kind of film needs, beside Pillow for drawing.
FILMS = {'.mp4': ('av', 'video'), '.gif': ('PIL', 'video')}
# Shortest and longest time for which a frame is shown, whatever lies between frames.
_FASTEST_S, _SLOWEST_S = 1 / 60, 1 / 5
_TRAIL_S = 1.0
# Small frames are enlarged by a whole number, so that their sides are about or at most that long.
_SHORT_SIDE_PX, _LONG_SIDE_PX = 480, 1280
# The contrast is that in the middle of so many frames: gains change, and one frame may flash.
_CONTRAST_FRAMES = 9


def check_film(name: str) -> None:
    """Refuse the name of a film that could not be written."""
    if Path(name).name != name or Path(name).suffix not in FILMS:
        raise ParameterError(f'a film must be the name of a file that ends with '
                             f'{" or ".join(FILMS)}, without a folder, got {name!r}')


def write_film(path: Path, recording: Recording, trajectories: list[Trajectory],
               progress: Progress | None = None) -> None:
    """Write every frame with the trajectories of its last second, their ids and SNR.

    Frames are read again one by one and shown for the median time between them, at least a
    sixtieth and at most a fifth of a second, so that slow recordings can be watched.

    Parameters
    ----------
    path : Path
        Ends with ``.mp4`` (PyAV) or ``.gif``.
    recording : Recording
    trajectories : list of Trajectory
    progress : callable, optional

    Raises
    ------
    DataError
        If there are too many pixels for the format.
    """
    steps = np.diff(recording.stamps[increasing_frames(recording.stamps)])
    interval = float(np.clip(np.median(steps) if len(steps) else 0, _FASTEST_S, _SLOWEST_S))
    pictures = _pictures(recording, trajectories, max(1, round(_TRAIL_S / interval)))
    if progress is not None:
        pictures = _watched(pictures, f'drawing {path.name}', len(recording), progress)
    write = _write_gif if path.suffix == '.gif' else _write_video
    write(path, pictures, interval)


def _pictures(recording: Recording, trajectories: list[Trajectory],
              length: int) -> Iterator[Any]:
    """Yield each frame as a picture of Pillow, with what was found in the last frames."""
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise MissingExtraError(
            "a film needs Pillow: pip install 'track_before_detect[video]'") from error
    short, long = sorted(recording.shape)
    factor = max(1, min(round(_SHORT_SIDE_PX / short), _LONG_SIDE_PX // long))
    font = ImageFont.load_default(14)
    limits: deque[tuple[float, float]] = deque(maxlen=_CONTRAST_FRAMES)
    for index in range(len(recording)):
        frame = real_picture(recording[index])
        limits.append(contrast_limits(frame))
        low, high = np.median(limits, axis=0)
        picture = Image.fromarray(grey_picture(frame, low, high)).convert('RGB')
        picture = picture.resize((picture.width * factor, picture.height * factor), 0)
        drawing = ImageDraw.Draw(picture)
        for trajectory in trajectories:
            _draw(drawing, trajectory, index, length, factor, font)
        yield picture


def _draw(drawing: Any, trajectory: Trajectory, index: int, length: int, factor: int,
          font: Any) -> None:
    """Draw the trail of a trajectory, and where it is in frame ``index`` a ring and a label."""
    positions, is_there = trail(trajectory, index, length)
    if not len(positions):
        return
    points = (positions + 0.5) * factor - 0.5
    colour = colour_of(trajectory.id)
    drawing.line([*map(tuple, points)], fill=colour, width=3)
    if is_there:
        x, y = points[-1]
        drawing.ellipse((x - 9, y - 9, x + 9, y + 9), outline=colour, width=2)
        drawing.text((x + 11, y - 18), f'{trajectory.id}  {trajectory.snr:.1f}', fill=colour,
                     font=font, stroke_width=1, stroke_fill='black')


def _watched(pictures: Iterator[Any], label: str, total: int, progress: Progress) -> Iterator[Any]:
    for done, picture in enumerate(pictures):
        progress(label, done / total)
        yield picture


def _write_video(path: Path, pictures: Iterator[Any], interval: float) -> None:
    """Encode pictures as they come; the format wants even sides."""
    try:
        import av
    except ImportError as error:
        raise MissingExtraError(
            "writing videos needs PyAV: pip install 'track_before_detect[video]'") from error
    codec = 'libx264' if 'libx264' in av.codecs_available else 'mpeg4'
    first = next(pictures)
    with (read_errors(f'{first.width} x {first.height} pixels cannot be encoded by {codec}',
                      (av.error.FFmpegError,)),
          av.open(str(path), 'w') as container):
        stream: Any = container.add_stream(
            codec, rate=Fraction(1 / interval).limit_denominator(1000))
        stream.pix_fmt = 'yuv420p'
        for number, picture in enumerate(chain([first], pictures)):
            rows = np.asarray(picture)
            rows = np.pad(rows, [(0, length % 2) for length in rows.shape[:2]] + [(0, 0)])
            if not number:
                stream.height, stream.width = rows.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rows, 'rgb24')))
        container.mux(stream.encode())


def _write_gif(path: Path, pictures: Iterator[Any], interval: float) -> None:
    """Write pictures as they come, which ``Image.save`` would gather, with one palette for all."""
    from PIL import GifImagePlugin, Image

    greys = np.linspace(0, 255, 256 - len(COLOURS)).round()
    palette = Image.new('P', (1, 1))
    palette.putpalette(np.vstack([np.repeat(greys[:, None], 3, 1), COLOURS])
                       .astype(np.uint8).tobytes())
    first = next(pictures)
    with (read_errors(f'{first.width} x {first.height} pixels are too many for a GIF',
                      (struct.error, OverflowError)),
          open(path, 'wb') as file):
        for number, picture in enumerate(chain([first], pictures)):
            reduced = picture.quantize(palette=palette, dither=Image.Dither.NONE)
            if not number:
                file.writelines(GifImagePlugin.getheader(reduced, info={'loop': 0})[0])
            # Hundredths of a second are all that the format knows.
            file.writelines(GifImagePlugin.getdata(
                reduced, duration=max(20, 10 * round(100 * interval))))
        file.write(b';')
