"""How mapped points move with a map is the slope of the map by its parameters."""

import numpy as np
import pytest

from track_before_detect.kernels.pictures.mapped_motion import mapped_motion


@pytest.mark.parametrize('n_parameters', [6, 8])
def test_motion_is_the_difference_that_a_small_change_makes(n_parameters):
    generator = np.random.default_rng(1)
    middle, scale = np.array([31.5, 19.5]), 37.0
    points = generator.uniform(0, 64, (20, 2))
    change = np.eye(3) + generator.normal(0, 0.05, (3, 3))
    outer = np.diag([30.0, 35.0, 1.0]) + generator.normal(0, 0.1, (3, 3))

    def mapped(parameters):
        moved = change.ravel() + np.append(parameters, np.zeros(9 - n_parameters)) / scale
        u = np.column_stack([(points - middle) / scale, np.ones(len(points))])
        x, y, depth = outer @ moved.reshape(3, 3) @ u.T
        return np.column_stack([x, y]) / depth[:, None]

    motion = np.empty((len(points), 2, n_parameters))
    mapped_motion(points, middle, scale, change, outer, motion)
    step = 1e-4
    expected = np.stack([(mapped(row) - mapped(-row)) / (2 * step)
                         for row in step * np.eye(n_parameters)], axis=2)
    np.testing.assert_allclose(motion, expected, rtol=1e-6, atol=1e-9)
