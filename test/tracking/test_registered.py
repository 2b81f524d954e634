"""Targets seen by a camera that turns and zooms come back in the pixels of each frame."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect import detect, geometry

SHAPE = (112, 140)
N_FRAMES = 11


def seen_by_a_turning_camera(seed, slope):
    """Return frames of a scene with two moving targets, and where these are, (2, T, 2)."""
    rng = np.random.default_rng(seed)
    middle = np.array([[1, 0, -0.5 * SHAPE[1]], [0, 1, -0.5 * SHAPE[0]], [0, 0, 1]])
    scene = ndimage.gaussian_filter(rng.normal(size=(212, 240)), 2.0)
    scene *= 10 / scene.std()
    starts, steps = np.array([(30, 35), (105, 80)]), np.array([(1.1, 0.6), (-0.8, -0.9)])
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    frames, positions = [], []
    for t in range(N_FRAMES):
        turn, zoom = np.deg2rad(0.5 * (t - 5)), 1.01**(t - 5)
        matrix = np.linalg.inv(middle) @ np.array([
            [zoom * np.cos(turn), -zoom * np.sin(turn), t - 5],
            [zoom * np.sin(turn), zoom * np.cos(turn), 5 - t],
            [slope * (t - 5), 0, 1]]) @ middle
        at = geometry.apply(geometry.inverse(matrix), np.stack([x, y], axis=-1)) + 50
        frame = ndimage.map_coordinates(scene, [at[..., 1], at[..., 0]], order=3)
        frame += rng.normal(0, 0.5, SHAPE)
        positions.append(geometry.apply(matrix, starts + t * steps))
        for place in positions[-1]:
            frame += 3 * np.exp(-0.5 * ((x - place[0])**2 + (y - place[1])**2))
        frames.append(frame)
    return np.array(frames), np.moveaxis(positions, 0, 1)


@pytest.mark.parametrize(('registration', 'slope'), [('affine', 0.0), ('homography', 1e-5)])
def test_targets_are_found_where_each_frame_shows_them(registration, slope):
    frames, positions = seen_by_a_turning_camera(1, slope)
    result = detect(frames, registration=registration, background='temporal_median',
                    noise='robust', threshold=11.0, max_speed_px_s=1.6)
    assert len(result.trajectories) == 2
    for found in result.trajectories:
        # Through maps that turn and zoom by less than a tenth they hardly change.
        shares = np.linalg.eigvalsh(found.covariance) * (found.snr * np.sqrt(N_FRAMES) / 2)**2
        assert (shares > 0.2).all() and (shares < 20).all()
    for truth in positions:
        errors = [np.sqrt(np.mean(np.sum((found.positions - truth)**2, axis=1)))
                  for found in result.trajectories]
        assert min(errors) < 0.4
