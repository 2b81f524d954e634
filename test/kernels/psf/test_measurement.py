"""A path on a plane is seen by every frame through its own map."""

import numpy as np
import pytest

import naive
from track_before_detect import geometry
from track_before_detect.kernels.amplitude_codes import NON_NEGATIVE, SIGNED
from track_before_detect.kernels.psf import measurement as kernel
from track_before_detect.kernels.scores import mapped_scores
from track_before_detect.models.measurement.multi_sensor import MultiSensor
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf

SHAPES = ((13, 16), (11, 12))
PSFS = (GaussianPsf(1.0), ArrayPsf(np.add.outer(np.arange(5.0), np.arange(3.0)**2) + 1))
MAPS = np.array([
    [[0.9, -0.3, 2.0], [0.25, 1.1, -1.5], [0, 0, 1]],
    [[1.0, 0.4, -3.0], [-0.3, 0.8, 2.5], [2e-3, -1e-3, 1]],
])
SENSOR = np.array([0, 1, 1, 0])
VIEW = MultiSensor(PSFS, SHAPES, SENSOR, MAPS[SENSOR], (12, 15))
POSITIONS = np.array([[5.3, 6.1], [6.0, 5.2], [7.4, 4.4], [1.0, 2.5]])


def weights_of(kind):
    weights = np.zeros((4, 13, 16), np.float32)
    for t, sensor in enumerate(SENSOR):
        weights[t, :SHAPES[sensor][0], :SHAPES[sensor][1]] = 1
    if kind == 'masked':
        weights *= np.random.default_rng(0).random(weights.shape) > 0.2
    return weights


def pictures(positions, weights):
    """Draw the unit-norm picture of a target in each padded frame, pixel by pixel."""
    drawn = np.zeros(weights.shape)
    for t, sensor in enumerate(SENSOR):
        at = geometry.apply(MAPS[sensor], positions[t])
        picture = naive.cut(naive.psf_picture(PSFS[sensor], at), SHAPES[sensor])
        drawn[t, :SHAPES[sensor][0], :SHAPES[sensor][1]] = picture
        drawn[t] *= weights[t]
        drawn[t] /= np.linalg.norm(drawn[t]) or 1
    return drawn


def looked(positions, frames, weights):
    out, norms = np.empty((len(positions), 3)), np.empty(len(positions))
    kernel.evaluate(VIEW.compiled(), positions, frames, weights, SIGNED, out, norms)
    return out


@pytest.mark.parametrize('kind', ['whole', 'masked'])
def test_a_path_is_drawn_at_its_mapped_positions(kind):
    weights = weights_of(kind)
    size = 2 * max(psf.half_width for psf in PSFS) + 1
    stamps, origins = np.empty((4, size, size)), np.empty((4, 2), np.int64)
    kernel.render_path(VIEW.compiled(), POSITIONS, 13, 16, weights, stamps, origins, np.empty(4))
    expected = pictures(POSITIONS, weights)
    for t in range(4):
        picture = np.zeros((13 + 2 * size, 16 + 2 * size))
        x, y = origins[t] + size
        picture[y:y + size, x:x + size] = stamps[t]
        np.testing.assert_allclose(picture[size:-size, size:-size], expected[t], atol=1e-4)


@pytest.mark.parametrize('kind', ['whole', 'masked'])
def test_statistics_are_products_with_the_picture(kind):
    weights = weights_of(kind)
    frames = np.random.default_rng(1).normal(size=weights.shape).astype(np.float32)
    expected = np.einsum('tyx,tyx->t', pictures(POSITIONS, weights), frames)
    np.testing.assert_allclose(looked(POSITIONS, frames, weights)[:, 0], expected, atol=2e-4)


def test_slopes_are_those_on_the_plane():
    # in the middle of frames, where the norm does not change
    shift = geometry.translations(np.array([[20.0, 20.0]]))
    psfs = (GaussianPsf(1.0), GaussianPsf(1.5))
    view = MultiSensor(psfs, ((50, 50), (50, 50)), SENSOR, (shift @ MAPS)[SENSOR], (12, 15))
    frames = np.random.default_rng(2).normal(size=(4, 50, 50)).astype(np.float32)

    def seen(positions):
        out = np.empty((4, 3))
        kernel.evaluate(view.compiled(), positions, frames, np.zeros((0, 0, 0), np.float32),
                        SIGNED, out, np.empty(4))
        return out

    for axis in range(2):
        step = 1e-4 * np.eye(2)[axis]
        change = (seen(POSITIONS + step) - seen(POSITIONS - step))[:, 0] / 2e-4
        np.testing.assert_allclose(seen(POSITIONS)[:, 1 + axis], change, atol=0.02)


@pytest.mark.parametrize('weights', [np.ones((1, *SHAPES[0])), np.zeros((0, 0, 0))],
                         ids=['weights', 'no weights'])
def test_what_lies_behind_the_horizon_of_a_map_is_not_seen(weights):
    view = MultiSensor(PSFS[:1], SHAPES[:1], np.zeros(1, int),
                     np.array([[[1.0, 0, 0], [0, 1, 0], [-0.2, 0, 1]]]), (12, 15))
    out, norms = np.empty((1, 3)), np.empty(1)
    frames = np.ones((1, *SHAPES[0]), np.float32)
    kernel.evaluate(view.compiled(), np.array([[9.0, 3]]), frames,
                    weights.astype(np.float32), SIGNED, out, norms)
    assert not out.any() and not norms.any()


@pytest.mark.parametrize('kind', ['whole', 'masked'])
@pytest.mark.parametrize('model', [NON_NEGATIVE, SIGNED])
def test_scores_are_squared_statistics_at_every_position(kind, model):
    places = [(0, 0), (5, 28), (12, 13), (22, 7), (9, 20)]
    weights = weights_of(kind)
    frames = np.random.default_rng(3).normal(size=weights.shape).astype(np.float32)
    scores = np.full((4, 23, 29), np.nan, np.float32)
    compiled = VIEW.compiled()
    for sensor, shape in enumerate(SHAPES):
        which = np.flatnonzero(SENSOR == sensor)
        cut = (which, slice(shape[0]), slice(shape[1]))
        pixels = np.ascontiguousarray(np.moveaxis(frames[cut] * weights[cut], 0, -1))
        squares = np.ascontiguousarray(np.moveaxis(weights[cut]**2, 0, -1))
        if kind == 'whole':
            squares = np.empty((0, 0, len(which)), np.float32)
        # Only the rows that are looked at: without the compiler the others take seconds.
        for row, _ in places:
            mapped_scores.scores_of_frames(
                scores, which, pixels, np.empty((0, 0, len(which)), np.float32), squares,
                compiled.optics[sensor], MAPS[sensor], 0.5, model, row, row + 1)
    assert {*np.nonzero(np.isfinite(scores))[1]} == {row for row, _ in places}
    for row, column in places:
        place = np.tile([0.5 * column, 0.5 * row], (4, 1))
        h = looked(place, frames, weights)[:, 0]
        if model == NON_NEGATIVE:
            h = np.maximum(h, 0)
        np.testing.assert_allclose(scores[:, row, column], h**2, atol=1e-4)
