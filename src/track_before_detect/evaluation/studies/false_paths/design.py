"""Options and frames for which noise is searched: spread evenly over what is modelled."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

# Least and largest frames, speed in px a frame and PSF in px, spread evenly in their logarithms.
FRAMES, SPEED, SIGMA = (5, 60), (0.2, 4.0), (0.6, 3.0)
# Of batches in which targets turn often.
LONG = (20, 60)
# Shares of the options with the acceleration by default, with none, and of targets that stand
# still; the others have another one, by default times these at most.
DEFAULT, STRAIGHT, STILL = 0.6, 0.15, 0.05
ACCELERATION = (0.25, 4.0)
INTERVALS_TO_MAX_SPEED = 30
MOST_POINTS = 256
# Of the sides of frames: px for one width of the PSF, and for what targets travel.
SIDE_PX, TRAVELS, LEAST_PX, MOST_PX, STEP_PX = 48.0, 1.2, 64, 192, 16


class Kind(NamedTuple):
    """What is modelled alike.

    Attributes
    ----------
    name : str
        What it is called in reports.
    options : mapping
        By which it is asked for.
    share, effort : float
        Of the sets of options, and of the time for one, that noise is searched with for the
        table: where there are few coefficients to fit, less does, and none where there are none.
    """

    name: str
    options: Mapping[str, Any]
    share: float = 0.35
    effort: float = 0.5


# The first two correct the others as well.
KINDS = (Kind('constant', {'amplitude_model': 'constant'}, 1.0, 1.0),
         Kind('fluctuating', {'amplitude_model': 'fluctuating'}, 1.0, 1.0),
         Kind('constant, partial', {'amplitude_model': 'constant', 'presence': 'partial'}),
         Kind('fluctuating, partial', {'amplitude_model': 'fluctuating', 'presence': 'partial'}),
         Kind('signed', {'amplitude_model': 'fluctuating', 'amplitudes': 'signed'}),
         Kind('signed, partial', {'amplitude_model': 'fluctuating', 'amplitudes': 'signed',
                                  'presence': 'partial'}),
         Kind('constant, integrated', {'amplitude_model': 'constant',
                                       'psf_model': 'integrated_gaussian'}, 0.0),
         Kind('fluctuating, integrated', {'amplitude_model': 'fluctuating',
                                          'psf_model': 'integrated_gaussian'}, 0.0))


def option_sets(count: int, seed: int, frames: tuple[int, int] = FRAMES,
                ) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield numbers of frames and options, one frame a second; more begin with the same."""
    for place in qmc.Sobol(5, seed=seed).random(MOST_POINTS)[:count]:
        n_frames = round(_between(frames, place[0]))
        speed = _digits(_between(SPEED, place[1]))
        options: dict[str, Any] = {'psf_sigma_px': _digits(_between(SIGMA, place[2])),
                                   'max_speed_px_s': speed}
        kind = place[3]
        if kind >= DEFAULT + STRAIGHT + STILL:
            options['max_acceleration_px_s2'] = _digits(
                speed / INTERVALS_TO_MAX_SPEED * _between(ACCELERATION, place[4]))
        elif kind >= DEFAULT + STRAIGHT:
            options['motion_model'] = 'static'
            del options['max_speed_px_s']
        elif kind >= DEFAULT:
            options['motion_model'] = 'constant_velocity'
        yield n_frames, options


def side_px(n_frames: int, options: Mapping[str, Any]) -> int:
    """Return the side of frames with room for many paths, that are searched fast."""
    travel = (0.0 if options.get('motion_model') == 'static'
              else options['max_speed_px_s'] * (n_frames - 1))
    room = SIDE_PX * max(options['psf_sigma_px'], 1.0)**0.5 + TRAVELS * travel
    return int(np.clip(STEP_PX * round(room / STEP_PX), LEAST_PX, MOST_PX))


def _between(ends: tuple[float, float], share: float) -> float:
    return float(ends[0] * (ends[1] / ends[0])**share)


def _digits(value: float) -> float:
    return float(f'{value:.3g}')
