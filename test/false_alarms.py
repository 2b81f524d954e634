"""What several tests of thresholds share."""

import numpy as np


def assert_rate_is_realised(passes, rate, n_runs, seed):
    """Assert that ``passes(generator)``, of one batch of noise, holds as often as asked for."""
    generator = np.random.default_rng(seed)
    found = sum(passes(generator) for _ in range(n_runs))
    # Four standard deviations of the count, and half as much again for the calibration itself.
    spread = 4 * np.sqrt(n_runs * rate * (1 - rate))
    assert n_runs * rate / 1.5 - spread < found < n_runs * rate * 1.5 + spread
