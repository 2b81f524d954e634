"""What stands still goes, what moves stays."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect import geometry
from track_before_detect.preprocess.background import (
    remove_temporal_median,
    temporal_median,
    without_spatial_median,
)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 12), st.integers(0, 999), st.floats(0, 0.6))
def test_temporal_median_equals_nanmedian_where_enough_is_known(n_frames, seed, share):
    rng = np.random.default_rng(seed)
    frames = rng.normal(size=(n_frames, 5, 7)).astype(np.float32)
    frames[rng.random(frames.shape) < share] = np.nan
    median = temporal_median(frames)
    enough = np.isfinite(frames).sum(axis=0) >= max(n_frames / 3, 1)
    np.testing.assert_array_equal(np.isfinite(median), enough)
    np.testing.assert_allclose(median[enough], np.nanmedian(frames[:, enough], axis=0), rtol=1e-6)


def test_temporal_median_leaves_its_input():
    frames = np.array([[[1.0, np.inf]], [[3.0, 2.0]]])
    before = frames.copy()
    temporal_median(frames)
    np.testing.assert_array_equal(frames, before)


def scene(x, y):
    return 50 * np.sin(x / 5) * np.cos(y / 4)


def test_a_still_scene_seen_at_fractions_of_a_pixel_goes_and_a_target_stays():
    rng = np.random.default_rng(0)
    fractions = rng.uniform(-0.5, 0.5, (15, 2))
    y, x = np.mgrid[:60, :70].astype(float)
    frames = np.array([scene(x - fx, y - fy) + 7 * t for t, (fx, fy) in enumerate(fractions)])
    for t in range(15):
        frames[t, 30, 10 + 3 * t] += 100.0
    residual = remove_temporal_median(frames, geometry.translations(fractions))[:, 4:-4, 4:-4]
    for t in range(15):
        assert residual[t, 26, 6 + 3 * t] == pytest.approx(100.0, abs=2.0)
        residual[t, 26, 6 + 3 * t] = 0
    assert np.abs(residual).max() < 2.0


@pytest.mark.parametrize(('first', 'gain'), [(12, 1.5), (9, 0.6), (3, 2.0), (17, 1.1)])
def test_a_gain_and_a_level_that_jump_leave_no_scene(first, gain):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[:60, :70].astype(float)
        frames = np.repeat(scene(x, y)[None], 20, axis=0)
        frames[first:] = 300 + gain * frames[first:]
        frames += rng.normal(size=frames.shape)
        frames[::3, 30, 40] += 40
        residual = remove_temporal_median(frames, geometry.translations(np.zeros((20, 2))))
        assert np.median(residual[::3, 30, 40]) > 35
        residual[:, 30, 40] = 0
        np.testing.assert_allclose(residual.std(axis=(1, 2)), 1.0, atol=0.06)


def test_frames_of_one_gain_are_not_touched():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[:48, :48].astype(float)
        frames = 0.1 * seed * scene(x, y) + rng.normal(size=(20, 48, 48))
        frames = frames.astype(np.float32)
        levels = np.median(frames[:, ::2, ::2] - frames[10, ::2, ::2], axis=(1, 2))
        centred = frames - levels[:, None, None]
        expected = frames - np.median(centred, axis=0)
        expected -= np.median(expected[:, ::2, ::2], axis=(1, 2))[:, None, None]
        residual = remove_temporal_median(frames, geometry.translations(np.zeros((20, 2))))
        np.testing.assert_allclose(residual, expected, atol=1e-4)


def test_noise_of_the_frames_stays_white():
    rng = np.random.default_rng(1)
    frames = rng.normal(size=(20, 64, 64))
    maps = geometry.translations(rng.uniform(-0.5, 0.5, (20, 2)))
    residual = remove_temporal_median(frames, maps)[:, 4:-4, 4:-4]
    neighbours = np.mean(residual[:, :, 1:] * residual[:, :, :-1])
    assert residual.std() == pytest.approx(1.0, abs=0.04)
    assert abs(neighbours) < 0.03


def test_shading_goes_and_a_target_stays():
    y, x = np.mgrid[:61, :83].astype(float)
    frames = np.stack([0.5 * x + 0.01 * (y - 30) ** 2, -0.3 * x])
    frames[0, 25, 40] += 100.0
    frames[:, :10, :10] = np.nan
    residual = np.stack([without_spatial_median(frame, 12) for frame in frames])
    assert residual[0, 25, 40] == pytest.approx(100.0, abs=1.0)
    residual[0, 25, 40] = 0
    inside = residual[:, 7:-7, 7:-7]
    assert np.nanmax(np.abs(inside)) < 1.5
    np.testing.assert_array_equal(np.isnan(residual), np.isnan(frames))


def test_a_frame_without_pixels_stays_so():
    assert np.isnan(without_spatial_median(np.full((20, 20), np.nan), 12)).all()
