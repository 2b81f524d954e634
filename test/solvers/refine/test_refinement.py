"""A refined path is weighed as the working set weighs it, and ends where its target is."""

import numpy as np
import pytest

from track_before_detect import geometry
from track_before_detect.models.amplitudes import (
    Complex,
    Constant,
    NonNegative,
    Signed,
    SignedConstant,
)
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.measurement.streak import StreakPsf
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.models.presence import presence_for
from track_before_detect.solvers.fit.working_set import StampRenderer, WorkingSet
from track_before_detect.solvers.refine.refinement import refiner_for
from track_before_detect.solvers.refine.target_model import TargetModel

T, SHAPE = 12, (30, 44)
TIMES = np.arange(float(T))
LINE = np.array([10.3, 12.6]) + TIMES[:, None] * np.array([1.4, 0.35])
NO_WEIGHTS = np.zeros((0, 0, 0), np.float32)
# Every other frame is that of a second sensor, which begins nine columns further right.
SENSOR = np.arange(T) % 2
MAPS = geometry.translations(np.array([[0.0, 0.0], [-19.0, 2.0]]))[SENSOR]
MEASUREMENTS = {
    'plain': GaussianPsf(1.0),
    'streak': StreakPsf(GaussianPsf(1.0), 0.9, 4.0, tuple(TIMES)),
    'sensors': MultiSensor((GaussianPsf(1.0), GaussianPsf(1.3)), (SHAPE, SHAPE), SENSOR, MAPS,
                           SHAPE),
}
WEIGHTS = {
    'none': NO_WEIGHTS,
    'one map': np.random.default_rng(1).uniform(0.5, 1.5, (1, *SHAPE)).astype(np.float32),
    'each frame': np.random.default_rng(2).uniform(0.5, 1.5, (T, *SHAPE)).astype(np.float32),
}


def frames_of(measurement, path, weights, amplitude, kind=np.float32, seed=3):
    """Return noise and a target, in units of the noise of each pixel."""
    rng = np.random.default_rng(seed)
    frames = np.zeros((T, *SHAPE), kind) + rng.standard_normal((T, *SHAPE)).astype(np.float32)
    stamps = StampRenderer(measurement, frames.shape, weights).render(path)
    for frame, picture, (x, y), norm in zip(frames, *stamps, strict=True):
        for i, k in zip(*np.nonzero(picture), strict=True):
            frame[y + i, x + k] += amplitude * norm * picture[i, k]
    return frames


def refiner_of(measurement, weights, model, partial=True, acceleration=0.02):
    graph = build_state_graph(TIMES, step_px=0.5, max_speed=2.0, max_acceleration=acceleration,
                              turn_cost=model.turn_cost)
    presence = presence_for(model) if partial else None
    return refiner_for(TargetModel(graph, measurement, TIMES, weights, model, presence))


@pytest.mark.parametrize('model', [NonNegative(), Signed(), Complex(), Constant(),
                                   SignedConstant()], ids=lambda model: type(model).__name__)
@pytest.mark.parametrize('weights', WEIGHTS)
@pytest.mark.parametrize('name', MEASUREMENTS)
def test_value_of_a_path_is_that_in_the_working_set(name, weights, model):
    measurement, kind = MEASUREMENTS[name], np.complex64 if model.is_complex else np.float32
    frames = frames_of(measurement, LINE, WEIGHTS[weights], 5.0, kind)
    paths = WorkingSet(frames, WEIGHTS[weights], measurement, 6.0, model)
    partial, full = (refiner_of(measurement, WEIGHTS[weights], model, partial)
                     for partial in (True, False))
    for first, last in ((0, T - 1), (0, 7), (4, T - 1), (3, 8), (5, 5)):
        path = np.full((T, 2), np.nan)
        path[first:last + 1] = LINE[first:last + 1]
        number = paths.add(path, 0.7)
        expected = paths.value(number)
        assert partial.value(frames, path, 0.7) == pytest.approx(expected, rel=1e-5)
        if last - first == T - 1:
            assert full.value(frames, path, 0.7) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('model', [NonNegative(), Constant()],
                         ids=lambda model: type(model).__name__)
@pytest.mark.parametrize('name', MEASUREMENTS)
def test_positions_and_frames_of_a_target_that_enters_are_found(name, model):
    measurement = MEASUREMENTS[name]
    truth = np.where(TIMES[:, None] >= 6, LINE, np.nan)
    frames = frames_of(measurement, truth, NO_WEIGHTS, 9.0)
    refiner = refiner_of(measurement, NO_WEIGHTS, model)
    start = np.where(TIMES[:, None] >= 8, LINE + (0.3, -0.2), np.nan)
    cost = presence_for(model).cost(8, T - 1, T)
    positions, cost = refiner.refine(frames, start, cost, 6.0, 0.0)
    # A frame in which nothing can be seen of a target of constant amplitude is free.
    whole = StampRenderer(measurement, frames.shape, NO_WEIGHTS).render(LINE)
    told = whole.norms > 0
    np.testing.assert_array_equal(np.isfinite(positions)[told], np.isfinite(truth)[told])
    assert np.nanmax(np.abs(positions - LINE)) < 0.4


def test_a_path_out_of_sight_of_one_sensor_goes_on_in_the_frames_of_the_other():
    # The second sensor sees nothing of it until the last frames.
    measurement, model = MEASUREMENTS['sensors'], NonNegative()
    frames = frames_of(measurement, LINE, NO_WEIGHTS, 9.0)
    refiner = refiner_of(measurement, NO_WEIGHTS, model)
    start = np.where(TIMES[:, None] >= 3, LINE + 0.2, np.nan)
    positions, _ = refiner.refine(frames, start, presence_for(model).cost(3, T - 1, T), 6.0, 0.0)
    assert np.isfinite(positions).all()
    assert np.abs(positions - LINE).max() < 0.4


def test_what_a_path_costs_is_told_from_the_weights_of_its_own_frames():
    # All pixels are masked before the target enters.
    weights = np.ones((T, *SHAPE), np.float32)
    weights[:6] = 0.0
    truth = np.where(TIMES[:, None] >= 6, LINE, np.nan)
    frames = frames_of(MEASUREMENTS['plain'], truth, weights, 9.0)
    frames[:6] = 0.0
    refiner = refiner_of(MEASUREMENTS['plain'], weights, Constant())
    cost = presence_for(Constant()).cost(6, T - 1, T)
    positions, _ = refiner.refine(frames, truth + 0.3, cost, 6.0, 0.0)
    assert np.nanmax(np.abs(positions - truth)) < 0.2


def test_a_target_of_constant_amplitude_is_there_while_a_mask_hides_it():
    weights = np.ones((T, *SHAPE), np.float32)
    weights[5:7] = 0.0
    frames = frames_of(MEASUREMENTS['plain'], LINE, weights, 6.0)
    frames[5:7] = 0.0
    refiner = refiner_of(MEASUREMENTS['plain'], weights, Constant())
    start = np.where(TIMES[:, None] >= 3, LINE + 0.2, np.nan)
    cost = presence_for(Constant()).cost(3, T - 1, T)
    positions, _ = refiner.refine(frames, start, cost, 6.0, 0.0)
    assert np.isfinite(positions).all()


@pytest.mark.parametrize('partial', [False, True])
def test_no_better_path_is_none(partial):
    model = NonNegative()
    frames = frames_of(GaussianPsf(1.0), LINE, NO_WEIGHTS, 9.0)
    refiner = refiner_of(GaussianPsf(1.0), NO_WEIGHTS, model, partial)
    cost = presence_for(model).cost(0, T - 1, T) if partial else 0.0
    positions, better = refiner.refine(frames, LINE + 0.2, cost, 6.0, 0.0)
    assert refiner.refine(frames, positions, better, 6.0, 0.0) is None
