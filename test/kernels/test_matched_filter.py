"""The fine matched filter equals one stamp at a time, and is the adjoint of drawing stamps."""

import numpy as np
import pytest

import naive
from track_before_detect.models.amplitudes import (
    AmplitudeModel,
    CONSTANT,
    NON_NEGATIVE,
    SIGNED,
)
from track_before_detect.models.psf import GaussianPsf
from track_before_detect.models.state_graph import build_state_graph
from track_before_detect.solvers.path_search import PathSearch


def search_for(psf, n_frames, shape, code=NON_NEGATIVE):
    graph = build_state_graph(np.arange(float(n_frames)), step_px=1 / psf.oversampling,
                              max_speed=0.5, max_acceleration=0.1, turn_cost=1.0)
    return PathSearch(graph, psf, shape, AmplitudeModel(code))


@pytest.mark.parametrize('sigma', [0.7, 1.0, 2.3])
@pytest.mark.parametrize('masked', [False, True])
@pytest.mark.parametrize(('code', 'score'), [
    (NON_NEGATIVE, lambda h: np.maximum(h, 0)**2), (SIGNED, lambda h: h**2),
    (CONSTANT, lambda h: h / np.sqrt(2))])
def test_scores_are_those_of_each_stamp(sigma, masked, code, score):
    generator = np.random.default_rng(8)
    frames = generator.standard_normal((2, 13, 17)).astype(np.float32)
    valid = generator.random(frames.shape) > 0.2 if masked else None
    if masked:
        frames[~valid] = 0
    psf = GaussianPsf(sigma)
    search = search_for(psf, 2, frames.shape[1:], code)
    search.set_mask(valid)
    scores = search.scores(frames)
    for t in range(2):
        statistic = naive.matched_filter(frames[t], sigma, psf.half_width, psf.oversampling,
                                         None if valid is None else valid[t])
        np.testing.assert_allclose(scores[t], score(statistic), atol=3e-3)


def test_statistic_has_unit_variance_up_to_the_border():
    psf = GaussianPsf(1.0)
    frames = np.random.default_rng(9).standard_normal((4000, 6, 6)).astype(np.float32)
    search = search_for(psf, 2, (6, 6))
    scores = search.scores(frames)
    # The positive half of a unit normal squared has mean 1/2 and variance 5/4.
    assert np.abs(scores.mean(axis=0) - 0.5).max() < 6 * np.sqrt(1.25 / 4000)
