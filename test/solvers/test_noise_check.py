"""Frames that are no noise are not searched for targets at every place; dense scenes are."""

import time

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.greedy import GreedyDetector
from track_before_detect.solvers.noise_check import threshold_bound

RNG = np.random.default_rng(5)
PEDESTAL = (8000 + 20 * RNG.standard_normal((40, 64, 64))).astype(np.float32)
PICTURES = np.clip(RNG.normal(110, 20, (40, 96, 96)), 0, 255).astype(np.uint8)
LOUD = 4 * RNG.standard_normal((40, 64, 64))
POWER = 4 * RNG.exponential(1.0, (20, 64, 64))


@pytest.mark.parametrize('detector', ['convex', 'greedy'])
@pytest.mark.parametrize(('frames', 'options', 'advice'), [
    (PEDESTAL, {'noise': 'robust'}, 'set background=temporal_median'),
    (PICTURES, {}, 'set background=temporal_median and noise=robust'),
    (LOUD, {}, 'set noise=robust'),
    (POWER, {}, 'set background=temporal_median and noise=robust')])
def test_what_is_no_noise_is_said_to_be_so(detector, frames, options, advice, caplog):
    begun = time.monotonic()
    # Without a threshold: none is calibrated for it.
    result = tbd.detect(frames, detector=detector, **options)
    assert time.monotonic() - begun < 20
    assert (result.status, result.trajectories) == ('not_noise', [])
    [remark] = result.remarks
    assert remark.endswith(advice) and remark in caplog.text


def test_the_advice_that_is_given_helps():
    result = tbd.detect(PICTURES, threshold=10.0, noise='robust', background='temporal_median')
    assert (result.status, result.trajectories) == ('converged', [])


def crowd(n_across, side, amplitude, sigma_px=1.0, noise=1.0, n_frames=10):
    frames = noise * np.random.default_rng(2).standard_normal((n_frames, side, side))
    places = np.linspace(0.06, 0.94, n_across) * side
    for t, frame in enumerate(frames):
        for y in places:
            for x in places:
                add_target(frame, x + 0.1 * t, y, sigma_px, amplitude)
    return frames


@pytest.mark.parametrize(('n_across', 'frames', 'sigma_px'), [
    (12, crowd(12, 128, 30.0), 1.0),
    (8, crowd(8, 88, 1000.0), 1.0),
    (8, crowd(8, 88, 1000.0, noise=0.0), 1.0),
    (2, crowd(2, 64, 1000.0, sigma_px=8.0), 8.0),
    (1, crowd(1, 64, 1000.0, sigma_px=12.0), 12.0)])
def test_bright_targets_all_over_the_frames_are_targets(n_across, frames, sigma_px):
    result = tbd.detect(frames, threshold=9.0, psf_sigma_px=sigma_px)
    assert (result.status, len(result.trajectories)) == ('converged', n_across**2)


def test_noise_never_reaches_the_bound_of_the_threshold():
    stamps = np.arange(6.0)
    detector = GreedyDetector(DetectorOptions())
    study = detector.noise_study(stamps, (32, 32))
    largest = study.searcher((32, 32))
    rng = np.random.default_rng(1)
    maxima = [largest(rng) for _ in range(100)]
    graph = build_state_graph(stamps, step_px=0.5, max_speed=1.0, max_acceleration=1 / 30,
                              turn_cost=1.0)
    bound = threshold_bound(graph, (63, 63), 0.05)
    # By no more than half, or it would be of little use.
    assert max(maxima) < bound < 2 * np.median(maxima)
