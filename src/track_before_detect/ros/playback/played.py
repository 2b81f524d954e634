"""What is played: a recording or a simulated scenario."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.cli.console import assignments
from track_before_detect.errors import DataError, ParameterError
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.recording import Recording
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.timestamps import increasing_frames


@dataclass(frozen=True)
class Played:
    """Frames, and when they are played.

    Attributes
    ----------
    frames : Recording or array, shape (T, H, W)
        Read one by one.
    stamps : array, shape (T,)
        In seconds, never decreasing.
    positions : array, shape (T,)
        When each is due at rate 1, in seconds from the first.
    interval_s : float
        From one frame to the next as a rule.
    truth : list of array, shape (N, 4)
        Rows [frame, id, x, y] of each target that is known, in known frames.
    frame_id : str
        Coordinate frame of the sensor.
    title, pace : str
        What is played, and how fast, in words.
    """

    frames: Recording | NDArray
    stamps: NDArray[np.float64]
    positions: NDArray[np.float64]
    interval_s: float
    truth: list[NDArray[np.float64]]
    frame_id: str
    title: str
    pace: str

    def close(self) -> None:
        """Close the recording."""
        if isinstance(self.frames, Recording):
            self.frames.close()


def open_played(values: Mapping[str, Any], warn: Callable[[str], None]) -> Played:
    """Open what the parameters of the frame publisher name.

    Parameters
    ----------
    values : mapping
        Of the parameters.
    warn : callable
        Takes a sentence about stamps that cannot be played as they are.
    """
    if values['input']:
        if values['scenario_set']:
            raise ParameterError(f'scenario_set ({values["scenario_set"]!r}) belongs to a '
                                 'simulated scenario, but input names a recording')
        recording = open_recording(values['input'], values['topic'] or None)
        return _played(values, recording, _playable(recording.stamps, warn), recording.truth,
                       recording.name, recording.frame_id, recording.stamps_known)
    if values['topic']:
        raise DataError(f'topic ({values["topic"]!r}) belongs to a bag, but input names none')
    made = simulate(values['scenario'], values['seed'],
                    **assignments(values['scenario_set'].split(), 'scenario_set'))
    return _played(values, made.frames, made.stamps, made.truth,
                   f'scenario {values["scenario"]}, seed {values["seed"]}')


def _played(values: Mapping[str, Any], frames: Recording | NDArray, stamps: NDArray[np.float64],
            truth: NDArray[np.float64] | None, title: str, frame_id: str = '',
            stamps_known: bool = True) -> Played:
    positions = stamps - stamps[0]
    pace = (f'over {positions[-1]:.2f} s as recorded' if stamps_known else
            'without stamps, so one frame per second (set rate_hz for another rate)')
    if values['rate_hz']:
        positions = np.arange(len(stamps)) / values['rate_hz']
        pace = f'{values["rate_hz"]:g} frames per second'
    interval_s = (float(np.median(np.diff(positions))) if len(positions) > 1
                  else 1.0 / (values['rate_hz'] or 1.0))
    rows = np.zeros((0, 4)) if truth is None else truth
    rows = rows[(rows[:, 0] >= 0) & (rows[:, 0] < len(stamps))]
    return Played(frames, stamps, positions, interval_s,
                  [rows[rows[:, 1] == target] for target in np.unique(rows[:, 1])],
                  values['frame_id'] or frame_id or 'camera', title, pace)


def _playable(stamps: NDArray[np.float64], warn: Callable[[str], None]) -> NDArray[np.float64]:
    """Return stamps that never jump back, wrong ones replaced by what lies between others."""
    increasing = increasing_frames(stamps)
    n_wrong = len(stamps) - len(increasing)
    if not n_wrong:
        return stamps
    warn(f'{n_wrong} of {len(stamps)} stamps do not increase; their frames are played between '
         'those around them')
    return np.interp(np.arange(len(stamps)), increasing, stamps[increasing])
