"""Large frames searched tile by tile."""

from dataclasses import replace

import numpy as np
import pytest

import track_before_detect as tbd
from track_before_detect.errors import ParameterError
from track_before_detect.option_models import psf_of
from track_before_detect.options import DetectorOptions
from track_before_detect.simulation.sensor import add_target
from track_before_detect.solvers.detectors import make_detector
from track_before_detect.solvers.tiles import tiles_of
from track_before_detect.types import FrameBatch

N_FRAMES, SIDE, TILE = 8, 160, 64
# The cores of three tiles end here.
SEAMS = (52.5, 106.5)


def scene(seed, n_frames=N_FRAMES):
    """Return frames with targets that cross each seam, and both where they meet, and alone."""
    rng = np.random.default_rng(seed)
    times = np.arange(n_frames) - (N_FRAMES / 2 - 0.5)
    places = [(SEAMS[0], 25.0), (SEAMS[1], 80.0), (30.0, SEAMS[0]), (80.0, SEAMS[1]),
              (SEAMS[0], SEAMS[1]), (SEAMS[1], SEAMS[0]), (135.0, 135.0), (25.0, 80.0)]
    frames = rng.standard_normal((n_frames, SIDE, SIDE)).astype(np.float32)
    tracks = []
    for place in places:
        angle = rng.uniform(0, 2 * np.pi)
        velocity = rng.uniform(0.2, 0.9) * np.array([np.cos(angle), np.sin(angle)])
        tracks.append(np.add(place, rng.uniform(-1, 1, 2)) + times[:, None] * velocity)
    # And a pair that overlaps on a seam.
    tracks.append(tracks[0] + (2.5, 0.0))
    for track in tracks:
        amplitude = rng.uniform(5.0, 12.0)
        for frame, position in zip(frames, track, strict=True):
            add_target(frame, *position, 1.0, amplitude)
    return frames, np.array(tracks)


@pytest.mark.parametrize('seed', range(10))
def test_targets_at_seams_are_found_once_and_where_the_whole_frame_has_them(seed):
    frames, tracks = scene(seed)
    whole = tbd.detect(frames, threshold=8)
    tiled = tbd.detect(frames, threshold=8, tile_px=TILE)
    assert tiled.threshold == whole.threshold
    assert tiled.status == whole.status == 'converged'
    found = np.array([one.positions for one in tiled.trajectories])
    for track in tracks:
        assert np.count_nonzero(np.hypot(*(found - track).mean(axis=1).T) < 1) == 1
    assert len(found) == len(whole.trajectories)
    for one, other in zip(whole.trajectories, tiled.trajectories, strict=True):
        np.testing.assert_allclose(other.positions, one.positions, atol=1e-6)
        np.testing.assert_allclose(other.amplitudes, one.amplitudes, rtol=1e-5)
        assert other.statistic == pytest.approx(one.statistic, rel=1e-6)


@pytest.mark.parametrize('model', ['fluctuating', 'constant', 'either'])
def test_the_threshold_is_that_of_the_whole_frame(model):
    options = DetectorOptions(amplitude_model=model, batch_length=N_FRAMES)
    batch = FrameBatch.of(np.zeros((N_FRAMES, SIDE, SIDE), np.float32))
    whole, tiled = make_detector(options), make_detector(options.replace(tile_px=TILE))
    expected = whole.threshold(batch.stamps, (SIDE, SIDE))
    assert tiled.threshold(batch.stamps, (SIDE, SIDE)) == expected
    assert tiled.detect(batch).threshold == pytest.approx(expected, rel=1e-12)
    assert tiled.threshold_source == whole.threshold_source


@pytest.mark.parametrize('shape', [(160, 160), (64, 500), (33, 131), (20, 20)])
@pytest.mark.parametrize('presence', ['full', 'partial'])
def test_tiles_cover_the_frame_and_hold_what_targets_of_their_core_cross(shape, presence):
    options = DetectorOptions(tile_px=TILE, max_speed_px_s=0.7, presence=presence)
    stamps = np.arange(float(N_FRAMES))
    tiles = tiles_of(options, stamps, shape, psf_of(options))
    frames = np.zeros((1, *shape), int)
    reach = 0.7 * (N_FRAMES - 1) * (0.5 if presence == 'full' else 1) + psf_of(options).half_width
    inside = np.array(shape[::-1]) - 1
    places = np.indices(shape)[::-1].reshape(2, -1).T
    for tile in tiles:
        core = places[tile.depth(places) >= 0]
        frames[0, core[:, 1], core[:, 0]] += 1
        assert (np.maximum(core.min(axis=0) - reach, 0) >= tile.begin).all()
        assert (np.minimum(core.max(axis=0) + reach, inside) <= tile.end - 1).all()
        assert tile.of(frames).shape == tiles[0].of(frames).shape
    assert (frames == 1).all()


def test_batches_that_follow_one_another_have_the_identities_of_the_whole_frame():
    frames, _ = scene(0, 12)
    whole, tiled = (tbd.detect(frames, threshold=8, batch_length=N_FRAMES, hop=4, **more)
                    for more in ({}, {'tile_px': TILE}))
    assert len(tiled.trajectories) == len(whole.trajectories)
    for one, other in zip(whole.trajectories, tiled.trajectories, strict=True):
        assert other.id == one.id
        # How often two that overlap are moved in turn depends on what the rest of the frame gains;
        # each is known to 0.1 px or so.
        is_of_pair = one.positions[0, 0] < SEAMS[0] + 8 and one.positions[0, 1] < 35
        np.testing.assert_allclose(other.positions, one.positions,
                                   atol=0.01 if is_of_pair else 1e-6)


@pytest.mark.parametrize('more', [
    {'detector': 'cfo_dp'}, {'calibration': 'clutter'}, {'motion_model': 'range_bearing'}])
def test_what_cannot_be_cut_into_tiles_is_refused(more):
    with pytest.raises(ParameterError, match='cannot honour tile_px'):
        tbd.detect(np.zeros((4, 40, 40)), tile_px=TILE, **more)


def test_a_frame_within_a_tile_is_searched_as_it_is():
    frames = scene(1)[0][:, :60, :60]
    options = DetectorOptions(threshold=8.0, tile_px=TILE)
    batch = FrameBatch.of(frames)
    tiled, whole = (make_detector(one).detect(batch)
                    for one in (options, replace(options, tile_px=None)))
    assert len(tiled.found) == len(whole.found) > 0
    for one, other in zip(whole.found, tiled.found, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)
