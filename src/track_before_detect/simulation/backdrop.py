"""What is behind targets: clouds and ground that pass through the picture of a camera."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Deviations of details by their scale in pixels, of 1 together: most is in what is large.
LAYERS = {2.0: 0.06, 8.0: 0.19, 40.0: 0.98}


def backdrop(rng: np.random.Generator, shape: tuple[int, int, int], layers: Mapping[float, float],
             step_px: ArrayLike, shake_px: float = 0.0) -> Iterator[NDArray[np.float32]]:
    """Yield pictures (H, W) of one texture, each a step further.

    Parameters
    ----------
    rng : Generator
        Draws the texture before the first picture, and nothing later.
    shape : tuple of int
        (T, H, W).
    layers : mapping from float to float
        Standard deviation of the smooth noise of each scale in pixels.
    step_px : array, shape (2,)
        What the camera moves by from frame to frame, x and y in pixels.
    shake_px : float
        Largest step beside that in x and in y.
    """
    # Whoever asks tbd what is missing may lack it.
    from scipy import ndimage

    n_frames, height, width = shape
    offsets = np.cumsum(
        np.asarray(step_px) + rng.uniform(-shake_px, shake_px, (n_frames, 2)), axis=0)
    offsets -= offsets.min(axis=0)
    right, down = np.ceil(offsets.max(axis=0)).astype(int) + 2
    texture = np.zeros((height + down, width + right), np.float32)
    for scale, deviation in layers.items():
        layer = ndimage.gaussian_filter(rng.standard_normal(texture.shape, np.float32), scale)
        texture += deviation / layer.std() * layer
    for x, y in offsets.tolist():
        yield ndimage.affine_transform(texture, np.eye(2), (y, x), (height, width), order=1)
