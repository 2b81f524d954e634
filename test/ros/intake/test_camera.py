"""Rays of calibrated cameras, against the formulas by which their lenses are described."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import CameraInfo, RegionOfInterest  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from track_before_detect.errors import DataError  # noqa: E402
from track_before_detect.ros.intake.camera_input import camera_of, CameraInput  # noqa: E402

F, CX, CY = 300.0, 160.0, 118.0
PLUMB_BOB = [-0.3, 0.12, 0.001, -0.002, -0.02]
RATIONAL = [0.5, -0.2, 0.001, -0.002, 0.01, 0.8, -0.1, 0.02]
FISHEYE = [-0.02, 0.01, -0.003, 0.0004]
TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def info(model='plumb_bob', d=(), **fields):
    return CameraInfo(**{
        'header': Header(frame_id='optical'), 'height': 240, 'width': 320,
        'distortion_model': model, 'd': list(d), 'k': [F, 0.0, CX, 0.0, F, CY, 0.0, 0.0, 1.0],
        'p': [250.0, 0.0, 150.0, 0.0, 0.0, 250.0, 120.0, 0.0, 0.0, 0.0, 1.0, 0.0], **fields})


def seen(ray, model, d):
    """Return the pixel at which a ray is seen, by the formulas of OpenCV's documentation."""
    x, y, z = ray
    if model == 'equidistant':
        off = np.hypot(x, y)
        angle = np.arctan2(off, z)
        bent = angle * (1 + sum(k * angle**(2 * i + 2) for i, k in enumerate(d)))
        a, b = (bent * x / off, bent * y / off) if off else (0.0, 0.0)
    else:
        k1, k2, p1, p2, k3, k4, k5, k6 = [*d, *[0.0] * (8 - len(d))]
        a, b = x / z, y / z
        r2 = a * a + b * b
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        a, b = (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
                b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b)
    return [CX + F * a, CY + F * b]


def rays(widest):
    rng = np.random.default_rng(3)
    angle, turn = widest * np.sqrt(rng.random(40)), rng.uniform(0, 2 * np.pi, 40)
    angle[0] = 0.0
    return np.column_stack([
        np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])


@pytest.mark.parametrize(('model', 'd', 'widest'), [
    ('plumb_bob', [], 0.9), ('plumb_bob', PLUMB_BOB[:4], 0.6), ('plumb_bob', PLUMB_BOB, 0.6),
    ('rational_polynomial', RATIONAL, 0.8), ('equidistant', FISHEYE, 1.8)])
def test_rays_are_those_that_the_lens_sends_to_a_pixel(model, d, widest):
    expected = rays(widest)
    found = camera_of(info(model, d), False).rays([seen(ray, model, d) for ray in expected])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_pixel_that_no_ray_reaches_has_none():
    # Beyond the largest radius that the polynomial gives.
    camera = camera_of(info(d=[-0.3, 0.0, 0.0, 0.0]), False)
    found = camera.rays([[CX + 3 * F, CY], [CX, CY]])
    assert np.isnan(found[0]).all() and found[1].tolist() == [0.0, 0.0, 1.0]


def test_a_part_of_the_sensor_and_binned_pixels_look_where_the_whole_does():
    whole = camera_of(info(d=PLUMB_BOB), False)
    part = camera_of(info(d=PLUMB_BOB, binning_x=2, binning_y=2, roi=RegionOfInterest(
        x_offset=40, y_offset=20, height=100, width=160)), False)
    assert (whole.shape, part.shape) == ((240, 320), (50, 80))
    np.testing.assert_array_equal(part.rays([[10.0, 30.0]]), whole.rays([[60.0, 80.0]]))


def test_rectified_frames_are_seen_by_p_and_others_are_turned_by_r():
    message = info(d=PLUMB_BOB, r=TURN.ravel().tolist())
    np.testing.assert_allclose(
        camera_of(message, True).rays([[150.0, 370.0]]), [[0.0, 0.5**0.5, 0.5**0.5]])
    np.testing.assert_allclose(camera_of(message, False).rays([[CX, CY]]), [[1.0, 0.0, 0.0]])


def test_angles_are_to_the_right_and_up_with_the_covariance_of_their_pixels():
    camera = camera_of(info(d=PLUMB_BOB), False)
    place, spread = np.array([230.0, 60.0]), np.array([[0.04, 0.01], [0.01, 0.09]])
    [(azimuth, elevation)] = camera.angles([place])
    assert azimuth > 0.2 and elevation > 0.1
    drawn = np.random.default_rng(5).multivariate_normal(place, spread, 20000)
    np.testing.assert_allclose(camera.covariance(np.array([place]), spread[None])[0],
                               np.cov(camera.angles(drawn).T), rtol=0.1)


@pytest.mark.parametrize(('fields', 'words'), [
    ({'k': [0.0] * 9}, 'not calibrated: a focal length is 0'),
    ({'k': [F, 0.0, CX, 0.0, F, CY, 0.0, 0.0, 0.0]}, 'matrix of the camera cannot be inverted'),
    ({'distortion_model': 'fov'}, "one of plumb_bob, rational_polynomial, equidistant, got 'fov'"),
    ({'d': [0.1, 0.2]}, r'plumb_bob must be 0 or 4 or 5 finite numbers, got \[0.1, 0.2\]'),
    ({'d': [float('nan')] * 5}, 'finite numbers, got')])
def test_what_cannot_be_used_is_refused_in_words(fields, words):
    with pytest.raises(DataError, match=words):
        camera_of(info(**fields), False)


def test_a_camera_that_is_not_that_of_the_frames_knows_nothing_and_says_so():
    said = []
    camera = CameraInput('info', False, lambda kind, text: said.append(text))
    assert np.isnan(camera.camera((240, 320), 'optical').rays([[0.0, 0.0]])).all()
    camera.take(info(k=[0.0] * 9))
    camera.camera((240, 320), 'optical')
    camera.take(info())
    camera.camera((120, 160), 'optical')
    assert said == [
        'nothing has come on info yet: no rays',
        'info cannot be used: the camera is not calibrated: a focal length is 0: no rays',
        'info tells of frames of 240 x 320 (height x width), found 120 x 160: no rays']
    assert camera.frame_id == 'optical'
    assert np.isfinite(camera.camera((240, 320), 'other').rays([[0.0, 0.0]])).all()
    assert "frames are of 'other', and info of 'optical'" in said[-1]
