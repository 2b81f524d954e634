"""Time of fitting the amplitudes of thousands of given paths, most of them near-duplicates.

Frames of one row with four targets of either sign, and all paths of constant velocity up to one
pixel a frame in steps of 0.05 whose PSF stays inside. To a duality gap of 1e-6 of the objective,
pricing of all paths included. ``test/solvers/given_paths/test_fit_paths.py`` compares with skglm.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.bench import Bench, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.solvers.given_paths.fit_paths import fit_paths

WIDTH_PX = 200
N_FRAMES = 20
N_TARGETS = 4
AMPLITUDE = 5.0
HALF_STAMP_PX = 4
LAMBDAS = (6.0, 7.5)
TOLERANCE = 1e-6


@dataclass(frozen=True)
class Fit:
    """The fit at one lambda."""

    lam: float

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure it."""
        frames, paths = all_constant_velocities(np.random.default_rng(SEED))

        def fitted() -> Any:
            return fit_paths(frames, paths, psf=GaussianPsf(1.0), lam=self.lam,
                             amplitudes='signed', tol=TOLERANCE)

        # Compilation is not what a fit costs.
        fit = fitted()
        [seconds] = timed([fitted], repeats)
        return {'lam': self.lam, 'gap': fit.gap, 'objective': fit.objective,
                'n_used': int(np.count_nonzero(np.any(fit.amplitudes, axis=1))),
                'fit': summary(seconds)}


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


def _facts() -> dict[str, Any]:
    _, paths = all_constant_velocities(np.random.default_rng(SEED))
    return {'n_paths': len(paths), 'n_frames': N_FRAMES}


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('lambda', 'paths used', 'gap / objective', 'wall ms', 'CPU ms')]
    for case in measured['cases']:
        rows.append((f'{case["lam"]:g}', str(case['n_used']),
                     f'{case["gap"] / case["objective"]:.1e}',
                     in_ms(case['fit']['wall_s'], 1), in_ms(case['fit']['cpu_s'], 1)))
    return [*aligned(rows), '',
            f'{measured["n_paths"]} paths over {measured["n_frames"]} frames; least of '
            f'{measured["repeats"]} (median in brackets).']


BENCH = Bench('fit', lambda large: {'cases': [Fit(lam) for lam in LAMBDAS]}, _lines, _facts)
