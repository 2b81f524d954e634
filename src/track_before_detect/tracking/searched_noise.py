"""Thresholds by a search of noise, beside those of the model."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from track_before_detect.errors import ParameterError
from track_before_detect.options import DetectorOptions
from track_before_detect.solvers.calibration.threshold import calibrate, level_passed
from track_before_detect.solvers.detectors import make_detector
from track_before_detect.types import Progress


class SearchedNoise(NamedTuple):
    """Both thresholds of one amplitude model.

    Attributes
    ----------
    amplitude_model : str
        As the option has it.
    rate : float
        False alarm rate that they are for.
    simulated : float
        That of the search of noise.
    modelled : float or None
        That of the model of noise, None beyond its options.
    modelled_rate : float or None
        What the model expects of the other threshold.
    """

    amplitude_model: str
    rate: float
    simulated: float
    modelled: float | None
    modelled_rate: float | None


def search_noise(options: DetectorOptions, stamps: NDArray, shape: tuple[int, int],
                 progress: Progress | None = None) -> list[SearchedNoise]:
    """Search noise for the threshold of a detector, and keep what is found for later searches.

    Parameters
    ----------
    options : DetectorOptions
        Of the detector.
    stamps : array, shape (T,)
        Of a batch, in seconds.
    shape : tuple of int
        (H, W) of the frames.
    progress : callable, optional
        Called with a label and the share done, 0 to 1.

    Returns
    -------
    list of SearchedNoise
        One for each amplitude model.
    """
    if options.threshold is not None or options.calibration != 'noise':
        raise ParameterError('a threshold that is given, or comes from each batch '
                             '(calibration=clutter), is not found by searching noise')
    found = []
    for part in make_detector(options).parts():
        study, rate = part.noise_study(stamps, shape), part.options.false_alarm_rate
        simulated = calibrate(study, shape, rate, progress, simulate=True).threshold
        modelled = modelled_rate = None
        if study.false_paths is not None:
            modelled = level_passed(study.false_paths, rate)
            modelled_rate = float(-np.expm1(-study.false_paths(simulated)))
        found.append(SearchedNoise(
            part.options.amplitude_model, rate, simulated, modelled, modelled_rate))
    return found
