"""Many alike neighbours that stand in the scene are no burst of targets, with nothing told."""

import itertools

import numpy as np
import pytest

from scenes.alike import recorded, SPOTS, straight
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.tracking.presets import choose_options
from track_before_detect.types import FrameBatch

N_FRAMES = 16


def found_in(frames):
    options = choose_options('auto', {}, frames).options
    batch = FrameBatch.of(frames, np.arange(len(frames)) / 25)
    return TrackingPipeline(options).process(batch).trajectories


def follows(trajectory, way):
    return np.nanmedian(np.hypot(*(trajectory.positions - way).T)) < 1.5


def test_alike_spots_are_found_as_rarely_as_asked():
    counts = []
    for number, (spots, snr, pan) in enumerate(itertools.product(SPOTS, (4, 10), (0.0, 0.8))):
        frames = recorded(np.random.default_rng([41, number]), N_FRAMES, spots=spots,
                          spots_snr=snr, pan_px=pan)
        counts.append(len(found_in(frames)))
    # Asked for is one batch in twenty.
    assert np.count_nonzero(counts) <= 0.1 * len(counts)
    assert max(counts) <= 2


@pytest.mark.parametrize('spots', ['flickering', 'blinking', 'wandering'])
@pytest.mark.parametrize(('start', 'pan_px'), [((36, 40), 0.0), ((36, 10), 0.8)],
                         ids=['over', 'beside'])
def test_a_target_is_found_among_dimmer_spots(spots, start, pan_px):
    way = straight(start, (1.1, 0.3), N_FRAMES)
    frames = recorded(np.random.default_rng([43, len(spots)]), N_FRAMES, [way], snr=6.0,
                      spots=spots, spots_snr=3, pan_px=pan_px)
    [found] = found_in(frames)
    assert follows(found, way)


@pytest.mark.parametrize('n_targets', [4, 8])
def test_alike_targets_in_formation_are_all_found(n_targets):
    wings = [(side, -abs(side)) for side in (0, 1, -1, 2, -2, 3, -3, 4)][:n_targets]
    ways = [straight((50 + 9 * back, 40 + 8 * side), (1.0, 0.4), N_FRAMES)
            for side, back in wings]
    found = found_in(recorded(np.random.default_rng([47, n_targets]), N_FRAMES, ways))
    assert len(found) == n_targets
    assert all(sum(follows(one, way) for one in found) == 1 for way in ways)
