"""Real scenes with noise added until their targets are as dim as asked for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from track_before_detect.evaluation.studies.real.labelled import LabelledRecording
from track_before_detect.evaluation.studies.real.truth import FRAME, HEIGHT, WIDTH, X, Y
from track_before_detect.tracking.recording import FrameSequence

# The peak of a target is looked for this far from its label, or in its box; its surroundings are
# a square frame that begins outside and is this wide.
PEAK_PX, GUARD_PX, SURROUNDINGS_PX = 2, 5, 7


@dataclass(frozen=True)
class Contrasts:
    """How labelled targets stand out in single frames.

    Attributes
    ----------
    peaks : array, shape (N,)
        Largest distance of a pixel of the target from the median around it.
    deviations : array, shape (N,)
        Standard deviation around it, clutter included.
    """

    peaks: NDArray[np.float64]
    deviations: NDArray[np.float64]

    def snr(self, sigma: float = 0.0) -> float:
        """Return the median SNR after noise of standard deviation ``sigma`` is added."""
        spread = np.hypot(self.deviations, sigma)
        return float(np.median(self.peaks / np.maximum(spread, np.finfo(float).tiny)))


def contrasts(labelled: LabelledRecording) -> Contrasts:
    """Measure all labelled targets of a recording."""
    peaks, deviations = [], []
    for label in labelled.truth.labels:
        frame = np.asarray(labelled.recording[int(label[FRAME])], float)
        row, column = np.indices(frame.shape)
        # How far outside the box, along rows and columns; negative within it.
        outside = np.maximum(np.abs(column - np.rint(label[X])) - label[WIDTH] / 2,
                             np.abs(row - np.rint(label[Y])) - label[HEIGHT] / 2)
        is_box = label[WIDTH] > 0
        guard = PEAK_PX if is_box else GUARD_PX
        around = frame[(outside > guard) & (outside <= guard + SURROUNDINGS_PX)]
        target = frame[outside <= (0 if is_box else PEAK_PX)]
        peaks.append(np.abs(target - np.median(around)).max())
        deviations.append(around.std())
    return Contrasts(np.array(peaks), np.array(deviations))


def sigma_for(found: Contrasts, snr: float) -> float:
    """Return the standard deviation of the noise to add for an SNR; 0 where it is lower as is."""
    if found.snr() <= snr:
        return 0.0
    # With noise alone around it a target would have at most this SNR.
    highest = float(found.peaks.max()) / snr
    return float(brentq(lambda sigma: found.snr(sigma) - snr, 0.0, highest))


class NoisyFrames:
    """The frames of a recording with white Gaussian noise added, the same in any order of access.

    Parameters
    ----------
    recording : FrameSequence
        Frames of real numbers.
    sigma : float
        Standard deviation of the noise, in the units of the frames.
    seed : int
        Of the noise.
    """

    def __init__(self, recording: FrameSequence, sigma: float, seed: int) -> None:
        self._recording = recording
        self._sigma = sigma
        self._seed = seed

    @property
    def stamps(self) -> NDArray[np.float64]:
        """Seconds, shape (T,)."""
        return self._recording.stamps

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        """Return one frame, shape (H, W)."""
        frame = np.asarray(self._recording[index], np.float32)
        noise = np.random.default_rng([self._seed, index]).standard_normal(
            frame.shape, np.float32)
        return frame + np.float32(self._sigma) * noise
