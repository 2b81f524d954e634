"""Without any option, recordings of the kinds that people have are searched as they should be."""

import csv

import numpy as np
import pytest

from scenes.kinds import KINDS, Variant
from track_before_detect.cli import main

VARIANTS = (
    Variant(seed=101, shape=(72, 104), fps=30, snr=5, level=3000, gain=12),
    Variant(seed=102, shape=(128, 64), fps=9, snr=6, level=12000, gain=60),
    Variant(seed=103, shape=(96, 80), fps=50, snr=4.5, level=900, gain=7),
)


def found_in(folder, recording):
    """Return the rows frame, x, y of each trajectory that the plain command finds."""
    np.savez(folder / 'a.npz', **recording)
    main(['detect', str(folder / 'a.npz'), '--no-overlay', '--output', str(folder / 'out')])
    trajectories = {}
    with open(folder / 'out' / 'trajectories.csv', newline='') as file:
        for row in csv.DictReader(file):
            trajectories.setdefault(row['trajectory_id'], []).append(
                [float(row[name]) for name in ('frame', 'x_px', 'y_px')])
    return [np.array(rows) for rows in trajectories.values()]


TOO_DIM = {
    ('photons', 103): 'an SNR of 4.5 among few counts: in the first batch the target reaches '
                      'three quarters of the threshold, so that 44 of 60 frames have it'}
# The pixels are those of one and the same camera, so that a variant each is enough.
OF_STAMPS = {'first_stamp_zero': 0, 'nanosecond_stamps': 1, 'dropped': 2}


def variants_of_kinds():
    for kind in KINDS:
        for number, variant in enumerate(VARIANTS):
            if OF_STAMPS.get(kind, number) != number:
                continue
            reason = TOO_DIM.get((kind, variant.seed))
            marks = [pytest.mark.xfail(strict=True, reason=reason)] if reason else []
            yield pytest.param(kind, variant, marks=marks, id=f'{kind}-{variant.seed}')


@pytest.mark.parametrize(('kind', 'variant'), list(variants_of_kinds()))
def test_the_target_is_the_one_trajectory(tmp_path, kind, variant):
    recording = KINDS[kind](variant, True)
    [rows] = found_in(tmp_path, recording)
    places = dict(zip(rows[:, 0].astype(int), rows[:, 1:], strict=True))
    near = [np.hypot(*(places.get(int(frame), np.full(2, np.inf)) - at)) <= 2
            for frame, _, *at in recording['truth']]
    assert np.mean(near) >= 0.8


# Where stamps alone differ the noise is the same; 'dropped' stands for them.
@pytest.mark.parametrize('kind', [kind for kind in KINDS if OF_STAMPS.get(kind, 2) == 2])
def test_hardly_anything_is_found_without_a_target(tmp_path, kind):
    # Asked for is one in twenty of about ten batches.
    assert len(found_in(tmp_path, KINDS[kind](VARIANTS[0], False))) <= 1
