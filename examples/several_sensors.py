"""Find with two cameras what neither finds alone.

Each frame is searched where its camera shows the target, with the point spread function and the
noise of that camera; nothing is resampled, and stamps may interleave.
"""
# %% One target, two cameras: the second is turned, sharper, noisier and half a frame later
import importlib.util

import numpy as np

import track_before_detect as tbd
from track_before_detect.simulation.sensor import add_target

rng = np.random.default_rng(4)
AFFINE = np.array([[0.9, -0.2, 14.0], [0.2, 0.9, -6.0]])  # from the second camera to the first


def course(stamps):
    """Return where the target is, in pixels of the first camera."""
    return np.array([18.0, 40.0]) + stamps[:, None] * np.array([1.4, -0.8])


def camera(stamps, affine, psf_sigma_px, noise_sigma):
    """Return a camera that films the target at an SNR of 2."""
    frames = rng.standard_normal((len(stamps), 64, 64))
    seen = np.linalg.solve(affine[:, :2], (course(stamps) - affine[:, 2]).T).T
    for frame, (x, y) in zip(frames, seen, strict=True):
        add_target(frame, x, y, psf_sigma_px, 2.0)
    return tbd.Sensor(noise_sigma * frames, stamps, affine, psf_sigma_px, noise_sigma=noise_sigma)


first = camera(np.arange(12.0), np.eye(2, 3), psf_sigma_px=1.2, noise_sigma=1.0)
second = camera(np.arange(12.0) + 0.5, AFFINE, psf_sigma_px=0.8, noise_sigma=5.0)

# %% Search each alone, then both together
for name, sensors in (('first', [first]), ('second', [second]), ('both', [first, second])):
    result = tbd.detect_sensors(sensors, threshold=8.5, max_speed_px_s=2.0)
    print(f'{name}: {len(result.trajectories)} found'
          + ''.join(f', statistic {found.statistic:.1f}' for found in result.trajectories))

# %% Positions are those of the common plane, here that of the first camera
for trajectory in result.trajectories:
    error = np.hypot(*(trajectory.positions - course(trajectory.stamps)).T)
    print(f'{len(error)} frames in the order of their stamps, error {error.mean():.2f} px, '
          f'velocity {trajectory.velocity.mean(axis=0).round(2)} px/s')

# %% A picture, where matplotlib is installed
if importlib.util.find_spec('matplotlib'):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 7), layout='compressed')
    corners = np.array([(0, 0), (63, 0), (63, 63), (0, 63), (0, 0)])
    axes.plot(*corners.T, label='view of the first camera')
    axes.plot(*(corners @ AFFINE[:, :2].T + AFFINE[:, 2]).T, label='view of the second')
    for trajectory in result.trajectories:
        axes.plot(*trajectory.positions.T, '.-', label='found by both together')
    axes.plot(*course(np.array([0, 11.5])).T, 'k--', label='truth')
    axes.set(xlabel='x in pixels of the first camera', ylim=(90, -10), aspect='equal')
    axes.legend(loc='lower left')
    figure.savefig('several_sensors.png', dpi=120)
