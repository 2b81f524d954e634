"""A diagonal W of the group norms, given to the detector as the variance of the noise."""

import numpy as np
import pytest

import naive
import track_before_detect as tbd
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.options import DEFAULT_CONTINUATION

T, SHAPE, LAM = 6, (16, 40), 8.0
PSF = GaussianPsf(1.0)
# A place of the grid: a convex solution that is the last has to pass there.
PATH = np.tile([8.0, 7.0], (T, 1))
COURSE = np.array([1.0, 0.8, 1.2, 0.9, 1.1, 1.0])
PER_FRAME = np.array([0.7, 1.5, 1.0, 2.0, 0.8, 1.2])
# Of each frame and pixel, and of each frame at the target.
WEIGHTS = {
    'frames': (np.broadcast_to(PER_FRAME[:, None, None], (T, *SHAPE)), PER_FRAME),
    'region': (np.where(np.arange(SHAPE[1]) < 22, 1.6, 0.9) * np.ones((SHAPE[0], 1)),
               np.full(T, 1.6)),
}


def scene(weights, eta):
    """Return frames of a target without noise and its amplitudes, |W^-1 h| being eta."""
    amplitudes = eta * COURSE / np.linalg.norm(COURSE / weights)
    frames = []
    for position, amplitude in zip(PATH, amplitudes, strict=True):
        picture = naive.cut(naive.psf_picture(PSF, position), SHAPE)
        frames.append(amplitude * picture / np.linalg.norm(picture))
    return np.array(frames), amplitudes


@pytest.mark.parametrize('name', WEIGHTS)
@pytest.mark.parametrize('continuation', [[1.0], [0.0], DEFAULT_CONTINUATION])
def test_a_lone_target_is_found_when_its_weighted_statistic_passes_lambda(name, continuation):
    pixels, weights = WEIGHTS[name]
    for share in (0.98, 1.02):
        frames, _ = scene(weights, share * LAM)
        found = tbd.detect(frames, threshold=LAM, variance=pixels**2,
                           continuation=continuation).trajectories
        assert len(found) == (share > 1)
        for trajectory in found:
            np.testing.assert_allclose(trajectory.statistic, share * LAM, rtol=2e-3)


@pytest.mark.parametrize('name', WEIGHTS)
def test_convex_amplitudes_are_those_of_weights_where_the_weights_do_not_change(name):
    pixels, weights = WEIGHTS[name]
    eta = 2.5 * LAM
    frames, amplitudes = scene(weights, eta)
    [found] = tbd.detect(frames, threshold=LAM, variance=pixels**2,
                         continuation=[1.0]).trajectories
    shared = {'psf': PSF, 'lam': LAM}
    # The variance measures the data as well, so that all frames are shrunk alike.
    np.testing.assert_allclose(found.amplitudes, (1 - LAM / eta) * amplitudes, rtol=5e-3)
    whitened = tbd.fit_paths(frames / pixels, PATH[None], **shared)
    np.testing.assert_allclose(weights * whitened.amplitudes[0],
                               (1 - LAM / eta) * amplitudes, rtol=1e-6)
    # Weights of the norm alone shrink a frame the more the larger its weight.
    weighted = tbd.fit_paths(frames, PATH[None], weights=weights, **shared).amplitudes[0]
    middle = np.linalg.norm(weights * weighted)
    np.testing.assert_allclose(weighted, amplitudes / (1 + LAM * weights**2 / middle), rtol=1e-6)
    assert np.allclose(found.amplitudes, weighted, rtol=5e-3) == (name == 'region')
