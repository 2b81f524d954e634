"""What a calibration searches: noise, by the detector whose threshold is wanted."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Smallest side of crops of noise whose maxima can be scaled to larger frames: paths near a border
# have fewer ways to go.
CROP_PX = 128
# Told a level, returns how many trajectories of noise pass it in a batch on average.
FalsePaths = Callable[[float], float]


@dataclass(frozen=True)
class NoiseStudy:
    """What a calibration has to know of a detector.

    Attributes
    ----------
    key : str
        Names everything that decides what is found in noise, apart from the size of the frames.
    area : callable
        Told (H, W), returns the number of places in which a trajectory can start: the number of
        false ones is in proportion.
    searcher : callable
        Told (H, W), returns a function that draws one batch of noise of that size from the
        generator it is given and returns the largest statistic in it. One is made per thread.
    whole_width : bool
        Whether columns differ, so that a narrower batch would not be like the whole.
    seconds : callable
        Told (H, W), returns the CPU time of one such search on a common machine, roughly: where
        it is long, fewer are made. A formula, so that equal calibrations stay equal.
    least_crop_px : int
        Smallest side of crops whose maxima can be scaled to larger frames.
    decay : float, optional
        Of a statistic that is a norm or a weighted sum of normal numbers: one over twice their
        variance, 1/2 for real noise and 1 for complex.
    false_paths : callable, optional
        Told a level, returns how many trajectories of noise pass it in a whole batch on average;
        None where that is not known without a search.
    """

    key: str
    area: Callable[[tuple[int, int]], float]
    searcher: Callable[[tuple[int, int]], Callable[[np.random.Generator], float]]
    whole_width: bool = False
    seconds: Callable[[tuple[int, int]], float] = lambda shape: 0.0
    least_crop_px: int = CROP_PX
    decay: float | None = None
    false_paths: FalsePaths | None = None


def noise_frames(generator: np.random.Generator, shape: tuple[int, ...],
                 is_complex: bool) -> NDArray:
    """Draw noise of unit variance, float32 or complex64, for a searcher of a study."""
    noise = generator.standard_normal(shape, dtype=np.float32)
    if not is_complex:
        return noise
    imaginary = generator.standard_normal(shape, dtype=np.float32)
    return (noise + 1j * imaginary) * np.float32(0.5**0.5)
