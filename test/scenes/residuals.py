"""What is left of real scenes, simulated: frames (T, H, W) whose bulk has unit deviation."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect.preprocess.robust import robust_deviation


def noise(rng, shape):
    return rng.standard_normal(shape)


def fixed_blobs(rng, shape, area_px=60):
    """Points of the scene that registration leaves, each frame a little beside the last."""
    n_frames, height, width = shape
    frames = rng.standard_normal(shape)
    y, x = np.mgrid[:height, :width]
    for _ in range(height * width // area_px):
        cx, cy, size = rng.uniform(0, width), rng.uniform(0, height), rng.exponential(0.25)
        size *= rng.choice([-1, 1])
        for frame in frames:
            dx, dy = rng.normal(0, 0.3, 2)
            frame += size * np.exp(-((x - cx - dx) ** 2 + (y - cy - dy) ** 2) / 4)
    return frames


def k_distributed(rng, shape):
    """Speckle with a texture that stays: sea, or a coarse radar cell."""
    texture = ndimage.gaussian_filter(rng.gamma(0.7, 1 / 0.7, shape[1:]), 1.5)
    return rng.standard_normal(shape) * np.sqrt(texture)


def codec_blocks(rng, shape):
    """Errors of 8 px blocks that a codec repeats for three frames."""
    n_frames, height, width = shape
    n_held, n_blocks = -(-n_frames // 3), (-(-height // 8), -(-width // 8))
    held = rng.laplace(0, 0.25, (n_held, *n_blocks)) * (rng.random((n_held, *n_blocks)) < 0.3)
    blocks = np.repeat(held, 3, axis=0)[:n_frames].repeat(8, axis=1).repeat(8, axis=2)
    return blocks[:, :height, :width] + rng.standard_normal(shape)


RESIDUALS: Mapping[str, Callable[[np.random.Generator, tuple[int, int, int]], NDArray]] = {
    'noise': noise,
    'fixed_blobs': fixed_blobs,
    'k_distributed': k_distributed,
    'codec_blocks': codec_blocks,
}


def residual(kind, rng, shape):
    """Return float32 frames of a kind."""
    frames = RESIDUALS[kind](rng, shape)
    return (frames / robust_deviation(frames)).astype(np.float32)


def add_target(frames, snr, start, step, sigma=1.5):
    """Add a target whose matched filter has a mean of ``snr`` in unit noise; return the way."""
    y, x = np.mgrid[:frames.shape[1], :frames.shape[2]]
    way = np.array(start) + np.arange(len(frames))[:, None] * np.array(step)
    for frame, (cx, cy) in zip(frames, way, strict=True):
        spot = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma ** 2))
        frame += snr * spot / np.linalg.norm(spot)
    return way
