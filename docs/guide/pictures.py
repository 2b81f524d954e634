"""Make the pictures of the page on recordings of one's own: ``python docs/guide/pictures.py``.

Three recordings are simulated, and the commands that the page names are run on them.
"""

from pathlib import Path
import shutil
import tempfile

import numpy as np
from scipy import ndimage

from track_before_detect.cli import main
from track_before_detect.recordings.npz import write_npz_recording
from track_before_detect.simulation.sensor import add_target

FPS = 25.0
N_FRAMES = 48
SHAPE = (128, 160)
NOISE = 6.0
HERE = Path(__file__).parent
COMMANDS = {
    'standing': 'detect standing.npz',
    'fast_missed': 'detect fast.npz',
    'fast_found': 'detect fast.npz --set max_speed_px_s=250',
    'pan_too_much': 'detect pan.npz --preset none --set background=temporal_median '
                    '--set noise=robust --set threshold=8 --set batch_length=16 '
                    '--set max_time_s=4',
    'pan_found': 'detect pan.npz',
}


def recording(step: tuple[float, float], snr: float, pan: float = 0.0, seed: int = 3):
    """Return frames of eight bits of a scene with one target, and rows [frame, id, x, y].

    Parameters
    ----------
    step : (float, float)
        Pixels that the target moves by in a frame, x and y.
    snr : float
        Of the matched filter in one frame.
    pan : float
        Pixels that the camera moves by in a frame, along x.
    seed : int
    """
    rng = np.random.default_rng(seed)
    margin = int(np.ceil(abs(pan) * N_FRAMES)) + 2
    wide = (SHAPE[0], SHAPE[1] + margin)
    scene = sum(weight * ndimage.gaussian_filter(rng.standard_normal(wide), sigma) * sigma
                for weight, sigma in ((60, 2), (60, 6), (90, 20)))
    rows, columns = np.mgrid[:SHAPE[0], :SHAPE[1]].astype(float)
    frames, truth = [], []
    middle = np.array([SHAPE[1], SHAPE[0]]) / 2
    for k in range(N_FRAMES):
        seen = ndimage.map_coordinates(scene, [rows, columns + abs(pan) * k], order=1)
        frame = rng.standard_normal(SHAPE)
        x, y = middle + (k - N_FRAMES / 2) * np.array(step)
        if 3 < x < SHAPE[1] - 3 and 3 < y < SHAPE[0] - 3:
            add_target(frame, x, y, 1.2, snr)
            truth.append((k, 0, x, y))
        frames.append(np.clip(110 + seen + NOISE * frame, 0, 255).astype(np.uint8))
    return np.array(frames), np.array(truth)


def make(folder: Path) -> None:
    """Make the recordings in a folder, search them there, and keep the pictures."""
    stamps = np.arange(N_FRAMES) / FPS
    for name, made in (('standing', recording((1.3, 0.6), 3.0)),
                       ('fast', recording((7.0, 1.0), 6.0)),
                       ('pan', recording((0.4, -0.9), 4.0, pan=0.8))):
        write_npz_recording(folder / f'{name}.npz', made[0], stamps, made[1])
    for name, command in COMMANDS.items():
        words = command.replace(' ', f' {folder}/', 1).split()
        print(f'$ tbd {command}', flush=True)
        main([*words, '--output', str(folder / name)])
        shutil.copyfile(folder / name / 'overlay.png', HERE / f'{name}.png')


if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as made:
        make(Path(made))
