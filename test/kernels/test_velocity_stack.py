"""Shift-and-stack beside sums over every frame of every velocity."""

import numpy as np
import pytest

import naive
from track_before_detect.kernels import velocity_stack
from track_before_detect.models.motion.velocity_grid import (
    _plan,
    GROUPS,
    velocity_grid,
)
from track_before_detect.solvers.velocity.shift_and_stack import VelocityStack

STAMPS = [
    pytest.param(np.arange(7.0), id='regular'),
    pytest.param(np.array([0.0, 1, 2, 5, 6, 6.5, 9, 10]), id='irregular'),
    pytest.param(np.arange(2.0), id='two frames'),
    pytest.param(np.zeros(1), id='one frame'),
]


def images(n_frames, shape, seed=1):
    rng = np.random.default_rng(seed)
    psi = rng.standard_normal((n_frames, *shape)).astype(np.float32)
    phi = rng.uniform(0.3, 2.0, psi.shape).astype(np.float32)
    phi[rng.random(phi.shape) < 0.2] = 0
    psi[phi == 0] = 0
    return psi, phi


@pytest.mark.parametrize('stamps', STAMPS)
@pytest.mark.parametrize('shape', [(9, 13), (1, 40), (3, 261)])
@pytest.mark.parametrize('signed', [False, True])
def test_best_velocity_equals_the_search_through_all(stamps, shape, signed):
    psi, phi = images(len(stamps), shape)
    grid = velocity_grid(stamps, 0.9)
    stack = VelocityStack(grid, shape, 0.5, signed)
    stack.run(psi, phi)
    statistics = naive.stacked_statistics(psi, phi, grid, 0.5, signed)
    np.testing.assert_allclose(stack.best, np.maximum(statistics.max(axis=0), 0), atol=1e-4)
    y, x = np.nonzero(stack.number >= 0)
    i, j = np.divmod(stack.number[y, x], len(grid.axis))
    chosen = np.cumsum(grid.last_vx - grid.first_vx)[i] - grid.last_vx[i] + j
    np.testing.assert_allclose(statistics[chosen, y, x], stack.best[y, x], atol=1e-4)


@pytest.mark.parametrize('group', GROUPS)
def test_every_plan_adds_up_the_same(group, monkeypatch):
    stamps = np.arange(11.0)
    psi, phi = images(11, (6, 20), 2)
    grid = velocity_grid(stamps, 2.0)
    whole = VelocityStack(grid, (6, 20), 0.5)
    whole.run(psi, phi)
    object.__setattr__(grid, 'plan', _plan(grid.moves, group))
    other = VelocityStack(grid, (6, 20), 0.5)
    other.run(psi, phi)
    np.testing.assert_allclose(other.best, whole.best, atol=1e-4)


def test_sharing_spares_most_additions():
    grid = velocity_grid(np.arange(20.0), 1.0, disc=False)
    assert grid.n_velocities == 1521
    assert grid.plan.n_additions < 0.4 * len(grid.axis) * 19


def test_part_of_the_positions_is_searched_in_place():
    psi, phi = images(8, (20, 170), 3)
    stack = VelocityStack(velocity_grid(np.arange(8.0), 1.0), (20, 170), 0.5)
    stack.run(psi, phi)
    best, number = stack.best.copy(), stack.number.copy()
    stack.best[4:9, 20:161] = 7
    stack.number[4:9, 20:161] = 7
    stack.run(psi, phi, (4, 9, 20, 161))
    np.testing.assert_array_equal(stack.best, best)
    np.testing.assert_array_equal(stack.number, number)


def test_threads_change_nothing():
    psi, phi = images(8, (40, 30), 4)
    found = []
    for n_threads in (1, 3):
        stack = VelocityStack(velocity_grid(np.arange(8.0), 1.0), (40, 30), 0.5, False, n_threads)
        stack.run(psi, phi)
        found.append(stack.best)
    np.testing.assert_array_equal(*found)


def test_plan_of_velocities_that_stand_still_is_one_sum():
    assert velocity_grid(np.arange(8.0), 0.0).plan.n_additions == 7
    assert velocity_stack.BLOCK % velocity_stack.STEP == 0
