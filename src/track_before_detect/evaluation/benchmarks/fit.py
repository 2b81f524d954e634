"""Time of fitting the amplitudes of thousands of given paths, most of them near-duplicates.

Frames of one row with four targets of either sign, and all paths of constant velocity up to one
pixel a frame in steps of 0.05 whose PSF stays inside. To a duality gap of 1e-6 of the objective,
pricing of all paths included. ``test/solvers/given_paths`` compares with skglm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.timing import (
    aligned,
    checked_repeats,
    in_ms,
    summary,
    timed,
)
from track_before_detect.evaluation.engine.machine import describe_machine, machine_line
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.solvers.given_paths.fit_paths import fit_paths
from track_before_detect.types import Progress

SEED = 1
WIDTH_PX = 200
N_FRAMES = 20
N_TARGETS = 4
AMPLITUDE = 5.0
HALF_STAMP_PX = 4
LAMBDAS = (6.0, 7.5)
TOLERANCE = 1e-6


def measure_fit(repeats: int, large: bool, progress: Progress) -> dict[str, Any]:
    """Measure the fit at each lambda; ``large`` changes nothing.

    Parameters
    ----------
    repeats : int
        Measurements of each.
    large : bool
        Of no consequence.
    progress : callable
        Called with a label and the share done, 0 to 1.
    """
    checked_repeats(repeats)
    progress('measuring', 0.0)
    frames, paths = all_constant_velocities(np.random.default_rng(SEED))
    fits = [lambda lam=lam: fit_paths(frames, paths, psf=GaussianPsf(1.0), lam=lam,
                                      amplitudes='signed', tol=TOLERANCE) for lam in LAMBDAS]
    # Compilation is not what a fit costs.
    done = [fit() for fit in fits]
    seconds = timed(fits, repeats)
    progress('measuring', 1.0)
    return {'bench': 'fit', 'seed': SEED, 'repeats': repeats, 'machine': describe_machine(),
            'n_paths': len(paths), 'n_frames': N_FRAMES, 'cases': [
                {'lam': lam, 'gap': fit.gap, 'objective': fit.objective,
                 'n_used': int(np.count_nonzero(np.any(fit.amplitudes, axis=1))),
                 'fit': summary(taken)}
                for lam, fit, taken in zip(LAMBDAS, done, seconds, strict=True)]}


def all_constant_velocities(generator: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Return frames (T, 1, W) of unit noise with targets, and all paths (P, T, 2) through them."""
    starts, speeds = np.meshgrid(np.arange(WIDTH_PX), np.arange(-20, 21) / 20)
    x = starts.reshape(-1, 1) + speeds.reshape(-1, 1) * np.arange(N_FRAMES)
    inside = ((x.min(axis=1) >= HALF_STAMP_PX)
              & (x.max(axis=1) <= WIDTH_PX - 1 - HALF_STAMP_PX))
    x = x[inside]
    frames = generator.standard_normal((N_FRAMES, 1, WIDTH_PX))
    for target in x[generator.choice(len(x), N_TARGETS, replace=False)]:
        profiles = np.exp(-0.5 * (np.arange(WIDTH_PX) - target[:, None])**2)
        profiles /= np.linalg.norm(profiles, axis=1, keepdims=True)
        frames[:, 0] += generator.choice([-AMPLITUDE, AMPLITUDE]) * profiles
    return frames, np.stack([x, np.zeros_like(x)], axis=-1)


def fit_table(measured: Mapping[str, Any]) -> str:
    """Return the measurements as text."""
    rows = [('lambda', 'paths used', 'gap / objective', 'wall ms', 'CPU ms')]
    for case in measured['cases']:
        rows.append((f'{case["lam"]:g}', str(case['n_used']),
                     f'{case["gap"] / case["objective"]:.1e}',
                     in_ms(case['fit']['wall_s'], 1), in_ms(case['fit']['cpu_s'], 1)))
    return '\n'.join([
        *aligned(rows), '',
        f'{measured["n_paths"]} paths over {measured["n_frames"]} frames; least of '
        f'{measured["repeats"]} (median in brackets).', f'{machine_line()}.'])
