"""Small recordings of the kinds that people report of their own, each with or without a target."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage


@dataclass(frozen=True)
class Variant:
    """One recording of a kind: seed, frame (H, W), frames per second, SNR, grey values.

    ``snr`` is that of the matched filter in one frame, ``level`` and ``gain`` make counts of
    unit noise.
    """

    seed: int
    shape: tuple[int, int]
    fps: float
    snr: float
    level: float
    gain: float
    n_frames: int = 60


class Scene:
    """Unit noise, and a way through it that keeps from the border."""

    def __init__(self, variant, target, n_frames=None, shape=None):
        self.n_frames = n_frames or variant.n_frames
        self.shape = shape or variant.shape
        self.rng = np.random.default_rng(variant.seed)
        self.variant, self.target = variant, target
        height, width = self.shape
        # From one side towards the other, 0.2 to 0.7 px a frame.
        direction = self.rng.uniform(0, 2 * np.pi)
        step = self.rng.uniform(0.2, 0.7) * np.array([np.cos(direction), np.sin(direction)])
        room = np.array([width, height]) / 2 - 12
        step *= min(1.0, *(2 * room / (np.abs(step) * self.n_frames)))
        centre = np.array([width, height]) / 2
        self.way = centre + step * (np.arange(self.n_frames)[:, None] - self.n_frames / 2)

    def noise(self):
        return self.rng.standard_normal((self.n_frames, *self.shape))

    def spots(self, sigma=1.0):
        """Return unit-norm pictures of the target, all zero without one."""
        y, x = np.mgrid[:self.shape[0], :self.shape[1]]
        spots = np.array([np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma ** 2))
                          for cx, cy in self.way])
        return self.target * spots / np.linalg.norm(spots, axis=(1, 2), keepdims=True)

    def signal(self):
        return self.noise() + self.variant.snr * self.spots()

    def truth(self):
        """Return rows frame, id, x, y."""
        return np.array([[k, 0, *at] for k, at in enumerate(self.way) if self.target],
                        ).reshape(-1, 4)


def counts(signal, level, gain, kind=np.uint16):
    return np.clip(np.rint(level + gain * signal), 0, np.iinfo(kind).max).astype(kind)


def _camera(variant, target, **more):
    scene = Scene(variant, target, **more)
    return scene, counts(scene.signal(), variant.level, variant.gain), scene.truth()


def black_clipped(variant, target):
    """Return a recording of a camera whose black level cuts off half of the noise."""
    scene = Scene(variant, target)
    frames = counts(scene.signal(), 1 + variant.seed % 2, 3 + variant.seed % 3, np.uint8)
    return {'frames': frames, 'fps': variant.fps, 'truth': scene.truth()}


def photons(variant, target):
    """One or two photons a pixel in the dark part, ten or more in the bright part."""
    scene = Scene(variant, target)
    rate = np.full(scene.shape, scene.rng.uniform(1, 3))
    bright = scene.rng.uniform(8, 20)
    rate[:, scene.shape[1] // 2:] = bright
    light = rate + variant.snr * np.sqrt(bright) * scene.spots()
    return {'frames': scene.rng.poisson(light).astype(np.uint8), 'fps': variant.fps,
            'truth': scene.truth()}


def frozen(variant, target):
    """Return a recording in which a shutter correction repeats one frame."""
    scene, frames, truth = _camera(variant, target)
    first = int(scene.rng.integers(15, 35))
    last = first + int(scene.rng.integers(6, 14))
    frames[first:last] = frames[first - 1]
    told = (truth[:, 0] < first) | (truth[:, 0] >= last)
    return {'frames': frames, 'fps': variant.fps, 'truth': truth[told]}


def repeated(variant, target):
    """Return a video of a higher frame rate than the camera that made it."""
    taken, shown = [(24, 30), (15, 20), (50, 60)][variant.seed % 3]
    scene, frames, truth = _camera(variant, target, n_frames=50)
    source = np.arange(50 * shown // taken) * taken // shown
    # The truth of the frames that hold something new.
    new = np.flatnonzero(np.diff(source, prepend=-1))
    rows = [[k, 0, *truth[source[k], 2:]] for k in new if target]
    return {'frames': frames[source], 'fps': variant.fps, 'truth': np.array(rows).reshape(-1, 4)}


def telemetry(variant, target):
    """Return a recording whose first row holds counters and clocks."""
    scene, frames, truth = _camera(variant, target)
    k = np.arange(len(frames))
    words = np.zeros((len(frames), scene.shape[1]), np.uint16)
    clock = 77_000_000 + 1000 / variant.fps * k
    words[:, :6] = np.stack([np.full(len(k), 0xA5A5), k, clock // 65536, clock % 65536,
                             28_500 + k // 11, 40 * k], axis=1)
    frames = np.concatenate([words[:, None], frames], axis=1)
    return {'frames': frames, 'fps': variant.fps, 'truth': truth + [0, 0, 0, 1]}


def _radar(as_stored):
    def made(variant, target):
        scene = Scene(variant, target, n_frames=40)
        noise = (scene.noise() + 1j * scene.noise()) / np.sqrt(2)
        phase = np.exp(2j * np.pi * scene.rng.random((40, 1, 1)))
        return {'frames': as_stored(noise + variant.snr * scene.spots() * phase).astype('f4'),
                'fps': variant.fps, 'truth': scene.truth()}
    return made


def stop_and_go(variant, target):
    """Return a recording of a target that stands still for a while."""
    scene = Scene(variant, target, n_frames=45)
    stand = int(scene.rng.integers(8, 13))
    steps = np.diff(scene.way, axis=0, prepend=scene.way[:1])
    # It moves as far in fewer frames.
    steps[15:15 + stand] = 0
    scene.way = scene.way[0] + np.cumsum(steps, axis=0) * 45 / (45 - stand)
    frames = counts(scene.signal(), variant.level, variant.gain)
    return {'frames': frames, 'fps': variant.fps, 'truth': scene.truth()}


def shaking(variant, target):
    """Return what a camera on a shaking mast sees of ground with edges."""
    scene = Scene(variant, target, n_frames=40)
    rng, (height, width) = scene.rng, scene.shape
    shape = height + 40, width + 40
    ground = 30 * ndimage.gaussian_filter(rng.standard_normal(shape), 2) / 0.14
    for _ in range(8):
        y, x = rng.integers(shape[0]), rng.integers(shape[1])
        ground[y:y + rng.integers(4, 20), x:x + rng.integers(4, 20)] += rng.uniform(-75, 75)
    ground = ndimage.gaussian_filter(ground, 0.8)
    jump = np.clip(np.cumsum(rng.normal(0, 0.7, (40, 2)), axis=0), -15, 15)
    y, x = np.mgrid[:height, :width]
    views = np.array([ndimage.map_coordinates(ground, [y + 20 + dy, x + 20 + dx], order=3)
                      for dx, dy in jump])
    # Slower over the ground, it would be part of the median of a batch.
    step = (scene.way[1] - scene.way[0]) / np.hypot(*(scene.way[1] - scene.way[0]))
    steps = np.arange(40)[:, None] - 19.5
    scene.way = np.array([width, height]) / 2 + rng.uniform(0.6, 0.9) * step * steps - jump
    return {'frames': np.rint(600 + views + 3 * scene.signal()).astype(np.uint16),
            'fps': variant.fps, 'truth': scene.truth()}


def first_stamp_zero(variant, target):
    """Return a recording whose driver fills in the first stamp too late."""
    _, frames, truth = _camera(variant, target)
    stamps = 1.69e9 + np.arange(len(frames)) / variant.fps
    stamps[0] = 0
    return {'frames': frames, 'stamps': stamps, 'truth': truth}


def nanosecond_stamps(variant, target):
    """Whole nanoseconds, as ROS writes them."""
    _, frames, truth = _camera(variant, target)
    stamps = 1_690_000_000_123_456_789 + np.arange(len(frames)) * round(1e9 / variant.fps)
    return {'frames': frames, 'stamps': stamps, 'truth': truth}


def dropped(variant, target):
    """Frames are lost; the stamps say so."""
    scene, frames, truth = _camera(variant, target)
    first = int(scene.rng.integers(12, 40))
    kept = np.delete(np.arange(len(frames)), slice(first, first + int(scene.rng.integers(3, 10))))
    rows = [[k, 0, *truth[i, 2:]] for k, i in enumerate(kept) if target]
    return {'frames': frames[kept], 'stamps': 1.69e9 + kept / variant.fps,
            'truth': np.array(rows).reshape(-1, 4)}


KINDS: Mapping[str, Callable[[Variant, bool], dict]] = {
    'black_clipped': black_clipped,
    'photons': photons,
    'frozen': frozen,
    'repeated': repeated,
    'telemetry': telemetry,
    'magnitude': _radar(np.abs),
    'power': _radar(lambda maps: np.abs(maps) ** 2),
    'decibels': _radar(lambda maps: 20 * np.log10(np.abs(maps))),
    'stop_and_go': stop_and_go,
    'shaking': shaking,
    'first_stamp_zero': first_stamp_zero,
    'nanosecond_stamps': nanosecond_stamps,
    'dropped': dropped,
}
