"""Images are moved by maps."""

import numpy as np
import pytest

from track_before_detect import geometry
from track_before_detect.kernels import warp
from track_before_detect.preprocess.resampling import shift_whole, warped


def naive_warp(image, matrix):
    """Interpolate by cubic convolution, pixel by pixel, from its definition."""

    def weight(distance):
        distance = abs(distance)
        if distance < 1:
            return 1.5 * distance**3 - 2.5 * distance**2 + 1
        if distance < 2:
            return -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2
        return 0.0

    height, width = image.shape
    out = np.full(image.shape, np.nan)
    for row in range(height):
        for column in range(width):
            x, y = geometry.apply(matrix, np.array([column, row]))
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                continue
            total = 0.0
            for i in range(int(np.floor(y)) - 1, int(np.floor(y)) + 3):
                for k in range(int(np.floor(x)) - 1, int(np.floor(x)) + 3):
                    if weight(x - k) and weight(y - i):
                        total += weight(x - k) * weight(y - i) * image[
                            min(max(i, 0), height - 1), min(max(k, 0), width - 1)]
            out[row, column] = total
    return out


MATRIX = np.array([[1.02, -0.05, 1.3], [0.06, 0.97, -2.2], [1e-3, -5e-4, 1.0]])


@pytest.mark.parametrize('matrix', [MATRIX, np.eye(3), np.diag([2.0, 0.5, 1.0])])
def test_warping_agrees_with_its_definition(matrix):
    image = np.random.default_rng(0).normal(size=(14, 19)).astype(np.float32)
    image[5, 6] = np.nan
    np.testing.assert_allclose(warped(image, matrix), naive_warp(image, matrix), atol=1e-5)


@pytest.mark.parametrize('matrix', [MATRIX, np.diag([1.0, -1.0, 1.0]),
                                    np.array([[1.0, 0, 7], [0, 1, 0.4], [0.1, 0, -0.55]])])
def test_the_nearest_pixel_is_that_on_the_border_beyond_it(matrix):
    image = np.random.default_rng(1).normal(size=(14, 19)).astype(np.float32)
    seen = np.empty_like(image)
    warp.nearest(image, matrix, seen)
    for row, column in np.ndindex(*image.shape):
        at = np.rint(np.nan_to_num(geometry.apply(matrix, np.array([column, row]))))
        x, y = np.clip(at, 0, (18, 13)).astype(int)
        assert seen[row, column] == image[y, x]


def test_a_smooth_image_is_followed():
    y, x = np.mgrid[:40, :50]

    def image(x, y):
        return np.sin(x / 4) + np.cos(y / 5)

    positions = geometry.apply(MATRIX, np.stack([x, y], axis=-1))
    moved = warped(image(x, y).astype(np.float32), MATRIX)
    inside = np.isfinite(moved)
    assert inside.mean() > 0.8
    expected = image(positions[..., 0], positions[..., 1])
    np.testing.assert_allclose(moved[6:-6, 6:-6], expected[6:-6, 6:-6], atol=2e-3)


def test_slopes_are_those_of_the_interpolated_image():
    rng = np.random.default_rng(1)
    image = rng.normal(size=(12, 13)).astype(np.float32)
    x, y = rng.uniform(1, 10, (2, 30))
    seen, before, after = np.empty((3, 30, 3))
    warp.sample_with_slope(image, x, y, seen)
    for axis, step in ((1, (1e-5, 0.0)), (2, (0.0, 1e-5))):
        warp.sample_with_slope(image, x - step[0], y - step[1], before)
        warp.sample_with_slope(image, x + step[0], y + step[1], after)
        np.testing.assert_allclose(seen[:, axis], (after - before)[:, 0] / 2e-5, atol=1e-4)


def test_whole_shift_reads_the_frame_at_position_plus_offset():
    frame = np.arange(30, dtype=np.float32).reshape(5, 6)
    moved = shift_whole(frame, np.array([2, -1]))
    assert moved[3, 1] == frame[2, 3]
    assert np.isnan(moved[0]).all() and np.isnan(moved[:, 4:]).all()
    assert np.isnan(shift_whole(frame, np.array([9, 0]))).all()
