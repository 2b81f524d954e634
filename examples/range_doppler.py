"""Find targets in range-Doppler maps, in which the Doppler says how fast the range changes.

Rows are range bins, columns Doppler bins. A target crosses up to eight range bins from one map to
the next, yet it needs no wide search: its column tells where its row goes.
"""
# %% Sixteen maps, one a second, with two targets
import importlib.util

import numpy as np

import track_before_detect as tbd
from track_before_detect.simulation.scenarios import simulate

RANGE_BINS_PER_DOPPLER_BIN = 0.3  # range bins a second; the sign is that of the radar
recording = simulate('range_doppler', seed=4, n_targets=2, snr=3.0,
                     range_bins_per_doppler_bin=RANGE_BINS_PER_DOPPLER_BIN)
n_maps, n_ranges, n_dopplers = recording.frames.shape
print(f'{n_maps} maps of {n_ranges} range x {n_dopplers} Doppler bins')

# %% Search along the lines that the Doppler draws
result = tbd.detect(recording.frames, recording.stamps, threshold=9.0,
                    motion_model='range_doppler',
                    range_bins_per_doppler_bin=RANGE_BINS_PER_DOPPLER_BIN)

# %% The range rate of a trajectory is what its Doppler bin says
for trajectory in result.trajectories:
    column = trajectory.positions[:, 0]
    said = RANGE_BINS_PER_DOPPLER_BIN * (column - n_dopplers // 2).mean()
    seen = trajectory.velocity[:, 1].mean()
    print(f'trajectory {trajectory.id}: from range bin {trajectory.positions[0, 1]:.1f}, Doppler '
          f'bin {column[0]:.1f}; moves {seen:+.2f} range bins/s, its Doppler says {said:+.2f}')
for target in np.unique(recording.truth[:, 1]):
    x, y = recording.truth[recording.truth[:, 1] == target, 2:][0]
    print(f'the truth of target {target:.0f}: from range bin {y:.1f}, Doppler bin {x:.1f}')

# %% A picture, where matplotlib is installed: the largest value of each range bin over time
if importlib.util.find_spec('matplotlib'):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 5), layout='constrained')
    axes.imshow(recording.frames.max(axis=2).T, cmap='gray', aspect='auto', origin='lower',
                extent=(-0.5, n_maps - 0.5, -0.5, n_ranges - 0.5))
    for trajectory in result.trajectories:
        axes.plot(recording.stamps, trajectory.positions[:, 1], lw=2,
                  label=f'found: {trajectory.id}')
    for target in np.unique(recording.truth[:, 1]):
        frame, _, _, y = recording.truth[recording.truth[:, 1] == target].T
        axes.plot(recording.stamps[frame.astype(int)], y, 'w--', lw=1)
    axes.set(title='Range over time; what was found, and dashed the truth',
             xlabel='time in s', ylabel='range bin')
    axes.legend()
    figure.savefig('range_doppler.png', dpi=120)
