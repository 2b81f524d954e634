"""The fine matched filter equals one stamp at a time, and has unit variance everywhere."""

import numba
import numpy as np
import pytest

import naive
from track_before_detect.models.amplitudes import (
    AmplitudeModel,
    COMPLEX,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED,
)
from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf
from track_before_detect.solvers.search.position_scores import PositionScores

PSFS = {
    'narrow': GaussianPsf(0.7),
    'gaussian': GaussianPsf(1.0),
    'wide': GaussianPsf(2.3),
    'integrated': GaussianPsf(0.6, integrated=True),
    'array': ArrayPsf(np.add.outer(np.arange(5.0), np.arange(7.0)**2) + np.eye(5, 7, 1) * 9),
}
SHAPE = (13, 17)
needs_thousands_of_frames = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason='plain Python takes minutes over 4000 frames of noise')


def scores_for(psf, shape, code=NON_NEGATIVE):
    n_rows = psf.oversampling * (shape[0] - 1) + 1
    return PositionScores(psf, shape, AmplitudeModel(code), lambda work: work(0, n_rows))


def weights_of(kind):
    generator = np.random.default_rng(3)
    return {'none': None, 'mask': (generator.random((2, *SHAPE)) > 0.2).astype(np.float32),
            'map': generator.uniform(0.3, 2, (1, *SHAPE)).astype(np.float32)}[kind]


@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('kind', ['none', 'mask', 'map'])
def test_scores_are_those_of_each_stamp(name, kind):
    psf, weights = PSFS[name], weights_of(kind)
    frames = np.random.default_rng(8).standard_normal((2, *SHAPE)).astype(np.float32)
    if kind == 'mask':
        frames[weights == 0] = 0
    expected = [naive.matched_filter(frame, psf, None if weights is None else
                                     weights[t % len(weights)])
                for t, frame in enumerate(frames)]
    for code, score in ((NON_NEGATIVE, lambda h: np.maximum(h, 0)**2), (SIGNED, lambda h: h**2)):
        scores = scores_for(psf, SHAPE, code)
        scores.set_weights(weights)
        found = scores.scores(frames)
        for t in range(2):
            # What the components left out of the filter make up.
            np.testing.assert_allclose(found[t], score(expected[t][0]), atol=4e-2)
    scores = scores_for(psf, SHAPE, CONSTANT)
    scores.set_weights(weights)
    found = scores.scores(frames, 0.5, 0.25)
    for t in range(2):
        statistic, norms = expected[t]
        if weights is None:
            np.testing.assert_allclose(found[t], 0.5 * statistic, atol=1e-2)
        else:
            seen = norms**2 > 1e-3
            np.testing.assert_allclose(
                found[t], seen * (0.5 * norms * statistic - 0.25 * norms**2), atol=1e-2)


@needs_thousands_of_frames
@pytest.mark.parametrize('name', PSFS)
@pytest.mark.parametrize('kind', ['none', 'mask', 'map'])
def test_statistic_has_unit_variance_up_to_borders_and_masks(name, kind):
    n_frames = 4000
    frames = np.random.default_rng(9).standard_normal((n_frames, *SHAPE)).astype(np.float32)
    scores = scores_for(PSFS[name], SHAPE, SIGNED)
    weights = weights_of(kind)
    if weights is not None:
        weights = weights[:1]
        frames *= weights[0] > 0
        scores.set_weights(weights)
    found = scores.scores(frames)
    # A unit normal squared has mean 1 and variance 2.
    assert np.abs(found.mean(axis=0) - 1).max() < 6 * np.sqrt(2 / n_frames)
    constant = scores_for(PSFS[name], SHAPE, CONSTANT)
    constant.set_weights(weights)
    np.testing.assert_allclose(n_frames * constant.scores(frames)**2, found, rtol=1e-3, atol=1e-4)


@needs_thousands_of_frames
def test_complex_statistic_has_unit_power_up_to_borders():
    n_frames = 4000
    parts = np.random.default_rng(9).standard_normal((2, n_frames, *SHAPE)).astype(np.float32)
    noise = (parts[0] + 1j * parts[1]) * np.float32(0.5**0.5)
    found = scores_for(GaussianPsf(1.0), SHAPE, COMPLEX).scores(noise)
    # The power of a circular normal of unit power has mean 1 and variance 1.
    assert np.abs(found.mean(axis=0) - 1).max() < 6 / np.sqrt(n_frames)
