"""The best path is that of all, for every measurement model, amplitude model and presence."""

import numpy as np
import pytest

from enumeration import best_in_any_frames
import naive
from track_before_detect.errors import ParameterError
from track_before_detect.models.amplitudes import amplitude_model
from track_before_detect.models.measurement.base import grid_shape
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.measurement.streak import StreakPsf, streaks_of
from track_before_detect.models.motion.range_doppler import build_range_doppler_graph
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.models.presence import Presence
from track_before_detect.solvers.search import viterbi_table
from track_before_detect.solvers.search.path_search import path_search
from track_before_detect.solvers.search.sheared_scores import ShearedScores
from track_before_detect.solvers.search.viterbi_table import RowThreads

KINDS = ['non-negative', 'signed', 'complex', 'non-negative constant', 'signed constant',
         'complex constant']
SHAPE = (6, 7)
# Of the plane that the sensors see.
SHAPES = ((6, 7), (5, 8))
MAPS = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]],
                 [[0.9, -0.2, 1.5], [0.2, 0.9, -1.2], [0, 0, 1]]])
SENSOR = np.array([0, 1, 0, 1])


def amplitudes_of(kind):
    name, _, constant = kind.partition(' ')
    return amplitude_model(name, constant or 'fluctuating')


class Combination:
    """A search, and what every position adds to the value of a path, found in another way."""

    def __init__(self, seen, kind, presence, weighted, acceleration):
        self.model = amplitudes_of(kind)
        generator = np.random.default_rng([KINDS.index(kind), presence, weighted])
        self.n_frames, self.shape = 4, SHAPE
        turn_cost = 0.1 if self.model.is_constant else 0.8
        motion = {'step_px': 1.0, 'max_speed': 0.7, 'max_acceleration': acceleration,
                  'turn_cost': turn_cost}
        pixels, self.graph = self.shape, None
        stamps = np.arange(4.0)
        if seen == 'plain':
            self.psf = GaussianPsf(2.0)
        elif seen == 'streak':
            motion['step_px'], motion['max_speed'] = 0.5, 1.6
            self.psf = StreakPsf(GaussianPsf(0.7), 1.0, 2.0, tuple(stamps))
        elif seen == 'sensors':
            self.psf = MultiSensor((GaussianPsf(2.0), GaussianPsf(2.3)), SHAPES, SENSOR,
                                   MAPS[SENSOR], SHAPE)
            pixels = self.psf.frame_shape(SHAPE)
        else:
            self.psf = GaussianPsf(2.0)
            self.graph = build_range_doppler_graph(
                stamps, step_px=1.0, rows_per_column=0.6, still_column=3.0,
                max_acceleration=acceleration, turn_cost=turn_cost)
        if self.graph is None:
            self.graph = build_state_graph(stamps, **motion)
        self.presence = None
        if presence:
            self.presence = Presence(0.0, 0.2, 0.3) if self.model.is_constant else Presence(
                0.4, 0.6, 0.9)
        self.weights = None
        if weighted:
            self.weights = generator.uniform(0.4, 1.5, (4, *pixels)).astype(np.float32)
            self.weights[2, :3] = 0
        self.frames = generator.standard_normal((4, *pixels))
        if self.model.is_complex:
            self.frames = self.frames + 1j * generator.standard_normal((4, *pixels))
        # Something in a few frames only, so that the best path is there in a part of them.
        self.frames[1:3, 2:4, 3:5] += 1.5 if kind != 'signed constant' else -1.5
        if weighted:
            self.frames *= self.weights > 0
        self.frames = self.frames.astype(np.complex64 if self.model.is_complex else np.float32)
        self.seen = seen

    def search(self):
        search = path_search(self.graph, self.psf, self.shape, self.model, self.presence, 2)
        search.set_weights(self.weights)
        return search

    def best(self, frames):
        """Return value and positions in pixels of the best of all paths."""
        kinds = None
        if self.seen == 'streak':
            kinds = streaks_of(self.graph, self.psf)[1]
            assert kinds.max() > 0
            products, squares = self.of_streaks(frames)
        elif self.seen == 'sensors':
            products, squares = self.through_maps(frames)
        else:
            h, n = zip(*(self.matched(frame, None if self.weights is None else self.weights[t])
                         for t, frame in enumerate(frames)), strict=True)
            n = np.ones(np.shape(n)) if self.weights is None else np.array(n)
            n = np.where(n**2 > 1e-3, n, 0)
            products, squares = n * np.array(h), n**2
        restore = self.shear(products, squares) if self.seen == 'range-doppler' else None
        if restore:
            products, squares, restore = restore
        code = self.model
        if code.is_constant:
            if code.is_complex:
                products = np.where(np.isinf(products.real), -np.inf, np.abs(products))
            best = max((best_in_any_frames(self.graph, np.where(
                np.isinf(products), products, sign * products), self.presence, squares, kinds)
                for sign in code.signs), key=lambda one: one[0])
        else:
            off = np.isinf(products.real)
            h = np.where(off, 0, products) / np.sqrt(np.maximum(squares, 1e-9))
            h = np.maximum(h, 0) if code.code == 0 else h
            best = best_in_any_frames(self.graph, np.where(off, -np.inf, np.abs(h)**2),
                                      self.presence, None, kinds)
        value, positions = best
        present = np.flatnonzero(np.isfinite(positions[:, 0]))
        if restore:
            positions[present] = restore(positions[present], present)
        return value, positions * self.graph.step_px

    def matched(self, frame, weights):
        if not np.iscomplexobj(frame):
            return naive.matched_filter(frame, self.psf, weights)
        (real, n), (imaginary, _) = (naive.matched_filter(part, self.psf, weights)
                                     for part in (frame.real, frame.imag))
        return real + 1j * imaginary, n

    def of_streaks(self, frames):
        """Return n h and n^2 of each kind; scores of streaks are compared with a twin elsewhere.

        Those of amplitudes that are constant, for each part of the numbers alone.
        """
        made = self.psf.scores(self.graph, self.shape, amplitudes_of('signed constant'),
                               RowThreads(grid_shape(self.psf, self.shape)[0], 1))
        made.set_weights(self.weights)
        parts = [frames.real.copy(), frames.imag.copy()] if np.iscomplexobj(frames) else [frames]
        products = [made.scores(part, 1.0) for part in parts]
        squares = np.ones(products[0].shape) if made.squares is None else made.squares
        return products[0] if len(parts) == 1 else products[0] + 1j * products[1], squares

    def through_maps(self, frames):
        """Return n h and n^2, stamp by stamp."""
        grid = grid_shape(self.psf, self.shape)
        products, squares = np.zeros((4, *grid), frames.dtype), np.zeros((4, *grid))
        weights = np.ones(frames.shape) if self.weights is None else self.weights
        for t, row, column in np.ndindex(products.shape):
            sensor = SENSOR[t]
            x, y, _ = MAPS[sensor] @ (column * self.graph.step_px, row * self.graph.step_px, 1)
            height, width = SHAPES[sensor]
            whole = np.exp(-0.5 * ((np.arange(-40, 60) - x)**2 + (
                np.arange(-40, 60)[:, None] - y)**2) / self.psf.psfs[sensor].sigma_px**2)
            stamp = whole[40:40 + height, 40:40 + width] / np.linalg.norm(whole)
            own = weights[t, :height, :width]
            square = np.sum((own * stamp)**2)
            if square > 1e-3:
                squares[t, row, column] = square
                products[t, row, column] = np.sum(frames[t, :height, :width] * own * stamp)
        return products, squares

    def shear(self, products, squares):
        shifts = self.graph.coupling.shifts(SHAPE[1], 1.0)
        made = ShearedScores(self.psf.scores(self.graph, SHAPE, self.model, RowThreads(6, 1)),
                             self.graph)
        padding = (made.grid_shape[0] - SHAPE[0]) // 2
        sheared = np.full((4, *made.grid_shape), -np.inf, products.dtype)
        left = np.zeros(sheared.shape)
        for t, y, x in np.ndindex(sheared.shape):
            row = y - padding + shifts[t, x]
            if 0 <= row < SHAPE[0]:
                sheared[t, y, x], left[t, y, x] = products[t, row, x], squares[t, row, x]
        return sheared, left, made.restore


CASES = [(seen, kind, presence) for seen in ('plain', 'streak', 'sensors', 'range-doppler')
         for kind in KINDS for presence in (False, True)
         if not (seen == 'sensors' and 'constant' in kind)
         and not (presence and kind == 'complex constant')]


@pytest.mark.parametrize('acceleration', [0.0, 0.3])
@pytest.mark.parametrize('weighted', [False, True], ids=['', 'weighted'])
@pytest.mark.parametrize(('seen', 'kind', 'presence'), CASES)
def test_best_path_equals_search_through_every_path(monkeypatch, seen, kind, presence, weighted,
                                                    acceleration):
    # Only what may pass is computed anew, even where filling the table would be quicker.
    monkeypatch.setattr(viterbi_table, 'COST_OF_UPDATE', 0.0)
    made = Combination(seen, kind, presence, weighted, acceleration)
    search, frames = made.search(), made.frames
    for number in range(3):
        expected, positions = made.best(frames)
        largest, [found] = search.best_paths(frames, expected - 0.5 * abs(expected), 1.0, 1)
        assert largest == pytest.approx(expected, rel=2e-5, abs=1e-4)
        assert found.value == pytest.approx(largest, rel=1e-6)
        np.testing.assert_array_equal(found.positions, positions)
        beyond = expected + 0.01 * abs(expected)
        largest, none = search.best_paths(frames, beyond, 1.0, 1)
        assert not none and largest <= beyond
        if number == 1:
            assert search.best_value(frames) == pytest.approx(expected, rel=2e-5, abs=1e-4)
        frames = frames.copy()
        frames[1 + number, 2:4, 2:5] *= 0.3


def test_one_amplitude_for_several_sensors_is_refused():
    view = MultiSensor((GaussianPsf(2.0), GaussianPsf(2.3)), SHAPES, SENSOR, MAPS[SENSOR], SHAPE)
    graph = build_state_graph(np.arange(4.0), step_px=1.0, max_speed=0.7, max_acceleration=0.0,
                              turn_cost=0.1)
    with pytest.raises(ParameterError, match='fluctuating for several sensors, got constant'):
        path_search(graph, view, SHAPE, amplitudes_of('signed constant'))
