"""Paths that stand out and are no target are rejected with a reason, targets pass."""

import numpy as np
import pytest
from scipy import ndimage

from track_before_detect import detect
from track_before_detect.solvers.batch_detector import FoundTrajectory
from track_before_detect.solvers.clutter.detector import BELOW
from track_before_detect.solvers.clutter.reasons import reason_against

N_FRAMES, SHAPE = 12, (72, 80)
Y, X = np.mgrid[:SHAPE[0], :SHAPE[1]]


def noise(seed):
    return np.random.default_rng(seed).standard_normal((N_FRAMES, *SHAPE))


def bar(x, y, length, angle=0.0, width=1.0, peak=2.5):
    """Return a bar in a frame, soft at its ends as the PSF makes it."""
    along = (X - x) * np.cos(angle) + (Y - y) * np.sin(angle)
    across = (Y - y) * np.cos(angle) - (X - x) * np.sin(angle)
    beyond = np.maximum(np.abs(along) - length / 2, 0)
    return peak * np.exp(-0.5 * (across ** 2 + beyond ** 2) / width ** 2)


def reason_of(frames, positions):
    """Return the reason against a path of amplitude one."""
    path = FoundTrajectory(positions, np.ones(N_FRAMES), 2.0, 5.0)
    return reason_against(path, frames, 1.0)


def along(speed):
    return np.column_stack([30 + speed * np.arange(N_FRAMES), np.full(N_FRAMES, 36.0)])


@pytest.mark.parametrize('angle', [0.0, 0.6, 1.57])
@pytest.mark.parametrize('speed', [0.0, 0.7])
@pytest.mark.parametrize('seed', range(3))
def test_a_line_longer_than_any_target_is_an_edge(angle, speed, seed):
    path = along(speed)
    frames = noise(seed) + [bar(x + 2, y, 26, angle) for x, y in path]
    assert reason_of(frames, path) == 'edge-like'


@pytest.mark.parametrize(('length', 'width', 'speed', 'peak'), [
    (0, 1.0, 1.5, 1.0), (8, 1.0, 0.5, 2.5), (8, 1.0, 0.0, 9.0), (3, 1.0, 3.0, 2.5),
    (6, 3.0, 1.0, 5.0)], ids=['dim', 'eight pixels', 'hovering', 'streak', 'blob'])
@pytest.mark.parametrize('seed', range(3))
def test_a_target_of_up_to_eight_pixels_is_none(length, width, speed, peak, seed):
    path = along(speed)
    frames = noise(seed) + [bar(x, y, length, width=width, peak=peak) for x, y in path]
    assert reason_of(frames, path) == ''


def found_and_reasons(frames, **options):
    result = detect(frames, calibration='clutter', max_speed_px_s=2.0, **options)
    return result.trajectories, [one.reason for one in result.rejected
                                 if one.reason != BELOW]


def test_a_detector_rejects_an_edge():
    frames = noise(1) + bar(38, 36, 24, 0.6, peak=6)
    found, reasons = found_and_reasons(frames)
    assert not found
    assert set(reasons) == {'edge-like'}


def panned(target, seed=3, pan=(1.6, 0.4)):
    """Return frames of a camera that pans, and where the scene and a target are in them.

    The scene holds one bright spot; the target moves by ``target`` pixels per frame.
    """
    rng = np.random.default_rng(seed)
    scene = ndimage.gaussian_filter(rng.standard_normal((160, 160)), 2)
    scene *= 3 / scene.std()
    frames = noise(seed)
    for t, frame in enumerate(frames):
        shift = np.array(pan) * t
        frame += ndimage.map_coordinates(
            scene, [Y + 40 - shift[1], X + 40 - shift[0]], order=3)
        for x, y, motion, peak in ((22, 30, pan, 60), (45, 48, target, 15)):
            frame += bar(x + motion[0] * t, y + motion[1] * t, 0, peak=peak)
    return frames


OPTIONS = {'registration': 'translation', 'search_plane': 'image', 'noise': 'local'}


@pytest.mark.parametrize('background', ['spatial_median', 'either'])
def test_a_part_of_the_scene_follows_it_and_a_target_does_not(background):
    motion = np.array([-0.5, 0.3])
    found, reasons = found_and_reasons(panned(motion), background=background, **OPTIONS)
    assert set(reasons) == {'follows the scene'}
    # The target is below what is usual beside the scene itself.
    assert len(found) == (background == 'either')
    for one in found:
        errors = one.positions - [(45, 48) + t * motion for t in range(N_FRAMES)]
        assert np.abs(errors).max() < 1


def test_what_stands_still_under_a_still_camera_follows_nothing():
    frames = panned(target=(1.0, 0.5), pan=(0.0, 0.0))
    found, reasons = found_and_reasons(frames, background='spatial_median', **OPTIONS)
    assert len(found) == 1
    assert np.abs(found[0].positions - (22, 30)).max() < 1
    assert reasons == []


def test_both_backgrounds_share_one_registration(caplog):
    found_and_reasons(noise(4), background='either', **OPTIONS)
    assert caplog.text.count('registration found no shift') == 1


@pytest.mark.parametrize('seed', range(3))
def test_where_nothing_is_found_the_strongest_path_is_told(seed):
    frames = np.random.default_rng(seed).standard_normal((8, 40, 40))
    result = detect(frames, calibration='clutter', false_alarm_rate=0.001)
    assert not result.trajectories
    assert 0.1 < max(one.statistic for one in result.rejected) <= 1
