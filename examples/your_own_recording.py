"""Find targets in a recording of your own.

``python examples/your_own_recording.py INPUT``, where INPUT is whatever ``tbd detect`` reads: a
``.npz`` file, a folder of images, a TIFF, a FITS cube, a video, a bag. Without one it makes a
small one.
"""
# %% Where the recording is; in an editor write its path here
import sys

import numpy as np

from track_before_detect.options import DetectorOptions
from track_before_detect.recordings.open_recording import open_recording
from track_before_detect.recordings.overlay import write_overlay
from track_before_detect.recordings.result_files import write_trajectories_csv
from track_before_detect.simulation.scenarios import simulate
from track_before_detect.tracking.recording import detect_recording

path = sys.argv[1] if len(sys.argv) == 2 and not sys.argv[1].startswith('-') else None

# %% Without one: a target before a scene that stands still, the noise 8 grey levels
if path is None:
    path = 'made.npz'
    made = simulate('maneuver', seed=1, height=96, width=96)
    y, x = np.mgrid[:96, :96]
    scene = 120 + 60 * np.sin(x / 9) * np.cos(y / 14)
    np.savez(path, stamps=made.stamps, truth=made.truth,
             frames=np.clip(scene + 8 * made.frames, 0, 255).astype(np.uint8))

# %% Say what the camera is like
# Nothing is known of the scene and of the noise, so both are estimated. Targets are as wide as
# psf_sigma_px says and move by at most one pixel a frame, unless max_speed_px_s says otherwise.
options = DetectorOptions(background='temporal_median', noise='robust', psf_sigma_px=1.0,
                          batch_length=20, hop=10, threshold=9.0)

# %% Search it, a batch of frames after the other
with open_recording(path) as recording:
    print(f'{recording.name}: {len(recording)} frames of {recording.shape[1]} x '
          f'{recording.shape[0]} pixels, {recording.dtype}')
    result = detect_recording(recording, options)
    middle, truth = recording[len(recording) // 2], recording.truth

for trajectory in result.trajectories:
    first = np.flatnonzero(np.isfinite(trajectory.positions[:, 0]))[0]
    print(f'trajectory {trajectory.id}: statistic {trajectory.statistic:.1f}, amplitude '
          f'{np.nanmedian(trajectory.amplitudes):.0f} grey levels, from frame {first} at '
          f'x = {trajectory.positions[first, 0]:.1f}, y = {trajectory.positions[first, 1]:.1f}')
if truth is not None:
    print(f'the truth begins at x = {truth[0, 2]:.1f}, y = {truth[0, 3]:.1f}')

# %% Keep what was found
write_trajectories_csv('trajectories.csv', result.trajectories)
try:
    write_overlay('your_own_recording.png', middle, result.trajectories, truth=truth)
except ImportError as missing:
    print(missing)
