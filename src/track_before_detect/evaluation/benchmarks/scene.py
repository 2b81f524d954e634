"""Time and memory of a camera scene with the options that ``preset=auto`` chooses for it.

The camera pans over a simulated texture of clouds and ground, whole frames with everything that
is done to them; each size in a process of its own, so that its peak memory is its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import functools
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.bench import Bench, CaseApart, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import ahead
from track_before_detect.preprocess.per_frame import KeptFrames
from track_before_detect.preprocess.prepare import noise_of_one, pictures, PreparedBatch
from track_before_detect.runs.own_process import peak_memory
from track_before_detect.simulation.backdrop import backdrop
from track_before_detect.simulation.sensor import add_target
from track_before_detect.tracking.pipeline import BACKGROUNDS, TrackingPipeline
from track_before_detect.tracking.presets import AUTO, choose_options, FRAMES_SEEN
from track_before_detect.types import FrameBatch

# Grey levels: what a pixel is about, its noise, and a target in the unit of its matched filter.
LEVEL, NOISE, TARGET = 2000.0, 4.0, 140.0
# Deviations of the texture in grey levels by its scale in pixels.
TEXTURE = {2.0: 3.4, 8.0: 11.0, 40.0: 56.0}
# Pixels per frame of the camera, at most as far beside that at a time, and of the target.
PAN, SHAKE, SPEED = (1.3, 0.1), 0.2, (0.6, -0.4)
PSF_SIGMA_PX = 1.5
# Batches that warm everything up.
N_WARM = 2


@dataclass(frozen=True)
class Scene(CaseApart):
    """A recording of frames of one size."""

    height: int
    width: int

    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure batches of it, and the two stages of their preprocessing once more alone."""
        return measure_scene(self, repeats)


def panning(scene: Scene, n_frames: int) -> NDArray[np.uint16]:
    """Return frames (T, H, W) of a texture over which the camera pans, with one target."""
    rng = np.random.default_rng(SEED)
    frames = np.empty((n_frames, scene.height, scene.width), np.uint16)
    for t, picture in enumerate(backdrop(rng, frames.shape, TEXTURE, PAN, SHAKE)):
        picture += LEVEL + NOISE * rng.standard_normal(picture.shape, np.float32)
        add_target(picture, 0.4 * scene.width + SPEED[0] * t, 0.5 * scene.height + SPEED[1] * t,
                   PSF_SIGMA_PX, TARGET)
        frames[t] = np.rint(picture)
    return frames


class _Preprocessing:
    """Its two stages, called for one batch after the other."""

    def __init__(self, options: DetectorOptions):
        self._options = options
        self._width_px = options.psf_sigma_px
        assert options.batch_length and options.hop
        self._kept = KeptFrames(options.batch_length - options.hop)
        self._seen: PreparedBatch | None = None

    def first(self, batches: Iterator[FrameBatch]) -> None:
        self._seen = pictures(next(batches), self._options, self._width_px, self._kept)

    def second(self, batches: Iterator[FrameBatch]) -> None:
        batch, background = next(batches), self._options.background
        assert self._seen is not None
        for one in BACKGROUNDS.get(background, (background,)):
            noise_of_one(self._seen, batch, self._options.replace(background=one), self._width_px,
                         self._kept)


def measure_scene(scene: Scene, repeats: int) -> dict[str, Any]:
    """Measure batches of a scene, and the two stages of their preprocessing once more alone."""
    before = peak_memory()
    looked_at = panning(scene, FRAMES_SEEN)
    options = choose_options(AUTO, {}, looked_at).options
    length, hop = options.batch_length, options.hop
    assert length and hop
    # While the last is searched no other is prepared, as in the midst of a recording.
    frames = panning(scene, length + hop * (N_WARM + repeats))

    def batches() -> Iterator[FrameBatch]:
        for first in range(0, len(frames) - length + 1, hop):
            at = np.arange(first, first + length)
            yield FrameBatch(frames[at], at.astype(float), at)

    pipeline, stages = TrackingPipeline(options), _Preprocessing(options)
    found, done = [], []
    for search in ahead(map(pipeline.prepare, batches())):
        found.append(len(search(None).trajectories))
        done.append((time.perf_counter(), time.process_time()))
    batch = np.diff(done, axis=0)[N_WARM - 1:-1]
    peak = peak_memory()
    each = [functools.partial(work, batches()) for work in (stages.first, stages.second)]
    for stage in each:
        for _ in range(N_WARM):
            stage()
    first, second = timed(each, repeats)
    [look] = timed([lambda: choose_options(AUTO, {}, looked_at)], repeats)
    seconds = {'batch': batch, 'look': look, 'pictures': first, 'noise_of_one': second,
               'search': batch - first - second}
    return {
        'height_px': scene.height, 'width_px': scene.width, 'batch_length': length, 'hop': hop,
        'n_trajectories': found[-1],
        'frames_per_s': hop / float(np.median(batch[:, 0])),
        'share_of_cpu': {name: float(np.median(seconds[name][:, 1]) / np.median(batch[:, 1]))
                         for name in ('pictures', 'noise_of_one', 'search')},
        'peak_memory_bytes': peak, 'peak_memory_before_bytes': before,
        **{name: summary(one) for name, one in seconds.items()},
    }


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ('frames', 'found', 'frames/s', 'batch', 'its CPU', 'pictures', 'background, noise',
         'search', 'look', 'peak MB')]
    for case in measured['cases']:
        share = case['share_of_cpu']
        rows.append((
            f'{case["width_px"]} x {case["height_px"]}', str(case['n_trajectories']),
            f'{case["frames_per_s"]:.1f}', in_ms(case['batch']['wall_s'], 0),
            in_ms(case['batch']['cpu_s'], 0),
            *(f'{share[stage]:.0%}' for stage in ('pictures', 'noise_of_one', 'search')),
            in_ms(case['look']['wall_s'], 0), f'{case["peak_memory_bytes"] / 1e6:.0f}'))
    case = measured['cases'][0]
    return [
        *aligned(rows), '',
        f'Times in ms, least of {measured["repeats"]} (median in brackets); shares of the CPU '
        'time of a batch.',
        f'Batches of {case["batch_length"]} frames every {case["hop"]}, each prepared while the '
        'one before is searched; frames/s by the median wall time from one to the next.']


BENCH = Bench('scene', lambda large: {
    'cases': [Scene(256, 320), *([Scene(512, 640)] if large else [])]}, _lines)
