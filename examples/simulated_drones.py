"""Find three simulated drones that no single frame shows.

The cells run one by one in an editor that knows ``# %%``, or all at once:
``python examples/simulated_drones.py``.
"""
# %% Forty frames of noise with three drones in them
import importlib.util

import numpy as np

import track_before_detect as tbd
from track_before_detect.simulation.scenarios import simulate

recording = simulate('eo_ir_drones', seed=2)
print(f'{len(recording.frames)} frames, the brightest pixel of the first is at '
      f'{recording.frames[0].max():.1f} times the noise')

# %% Search twenty frames at a time
# A trajectory is reported when its statistic passes the threshold. Left out, the threshold follows
# from false_alarm_rate: it is calibrated on simulated noise once, which takes a while, and kept.
result = tbd.detect(recording.frames, recording.stamps, batch_length=20, threshold=8.0)
print(f'{len(result.trajectories)} trajectories above {result.threshold:g}, {result.status}')

# %% Compare each trajectory with the true path that it is nearest to
true_paths = [recording.truth[recording.truth[:, 1] == target, 2:]
              for target in np.unique(recording.truth[:, 1])]
for trajectory in result.trajectories:
    present = np.isfinite(trajectory.positions[:, 0])
    distances = [np.hypot(*(trajectory.positions - path)[present].T) for path in true_paths]
    nearest = min(range(len(true_paths)), key=lambda target: np.median(distances[target]))
    error = np.sqrt(np.mean(distances[nearest]**2))
    speed = np.median(np.hypot(*trajectory.velocity[present].T))
    print(f'trajectory {trajectory.id} is drone {nearest}: SNR {trajectory.snr:.1f}, '
          f'{present.sum()} frames, {speed:.0f} px/s, error {error:.2f} px')

# %% A picture, where matplotlib is installed
if importlib.util.find_spec('matplotlib'):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 6), layout='constrained')
    axes.imshow(recording.frames[20], cmap='gray', vmin=-3, vmax=4)
    for trajectory in result.trajectories:
        axes.plot(*trajectory.positions.T, lw=2, label=f'found: {trajectory.id}')
    for path in true_paths:
        axes.plot(*path.T, 'w--', lw=1)
    axes.set(title='One of forty frames; what was found, and dashed the truth',
             xlabel='x in pixels', ylabel='y in pixels')
    axes.legend(loc='lower left')
    figure.savefig('simulated_drones.png', dpi=120)
