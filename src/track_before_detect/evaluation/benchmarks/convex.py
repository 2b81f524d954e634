"""Time and memory of the convex detector, stage by stage, with the machine described.

Every case runs in a process of its own, so that its peak memory is its own; the stages of a case
take turns, so that whatever else the machine does falls on all of them alike.
"""

from collections.abc import Mapping, Sequence
import dataclasses
from typing import Any

from track_before_detect.evaluation.benchmarks import path_search
from track_before_detect.evaluation.benchmarks.bench import Bench, CaseApart, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.models.amplitudes import amplitude_model
from track_before_detect.models.measurement.base import grid_shape
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.options import DetectorOptions
from track_before_detect.runs.own_process import peak_memory
from track_before_detect.simulation.scenarios import simulate, SimulatedRecording
from track_before_detect.solvers.convex.detector import ConvexDetector
from track_before_detect.solvers.search.viterbi_table import RowThreads, ViterbiTable
from track_before_detect.tracking.pipeline import TrackingPipeline
from track_before_detect.types import FrameBatch


@dataclasses.dataclass(frozen=True)
class Case(CaseApart):
    """One batch that is searched; fields as in the scenarios of the simulation."""

    name: str
    scenario: str
    overrides: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure it in this process."""
        made = simulate(self.scenario, SEED, **self.overrides)
        options = DetectorOptions(psf_sigma_px=made.scenario.psf_sigma_px)
        # Compilation and calibration are not what a warm batch costs.
        TrackingPipeline(options).warm_up(
            made.frames.shape[1:], 1 / made.scenario.fps, len(made.frames))
        # One after the other, so that the tables of the first are gone when the second makes
        # its own.
        detection = _measure_detection(made, options, repeats)
        stages = _measure_stages(made, options, repeats)
        volume_copy = stages['layer_copy']['wall_s']['min'] * len(made.frames)
        stages['over_volume_copy']['detection'] = (
            detection['detection']['wall_s']['min'] / volume_copy)
        return {
            'name': self.name,
            'scenario': self.scenario,
            'overrides': dict(self.overrides),
            'n_frames': len(made.frames),
            'height_px': made.frames.shape[1],
            'width_px': made.frames.shape[2],
            **detection,
            **stages,
        }


_SCENES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ('noise', 'noise', {}),
    ('three targets, SNR 3', 'three_targets', {'snr': 3.0}),
    ('six targets, SNR 5', 'three_targets', {'n_targets': 6, 'snr': 5.0}),
)
_FEW_AND_MANY = (_SCENES[2], ('fifty targets, SNR 5', 'three_targets',
                              {'n_targets': 50, 'snr': 5.0}))
_CROWD = (('200 targets, SNR 5', 'three_targets', {'n_targets': 200, 'snr': 5.0}),)


def cases(large: bool) -> dict[str, Sequence[Case | path_search.SearchCase]]:
    """Return what ``tbd bench convex`` measures."""
    sizes = [((128, 128), _SCENES), ((256, 256), _FEW_AND_MANY)]
    if large:
        sizes += [((512, 640), _SCENES), ((512, 512), _CROWD)]
    scenes = [Case(name, scenario, {'height': height, 'width': width, 'n_frames': 20, **overrides})
              for (height, width), scenes in sizes for name, scenario, overrides in scenes]
    return {'cases': scenes, 'searches': path_search.SEARCHES if large else ()}


def _measure_detection(made: SimulatedRecording, options: DetectorOptions,
                       repeats: int) -> dict[str, Any]:
    """Measure whole detections."""
    before = peak_memory()
    detector = ConvexDetector(options)
    result = detector.detect(FrameBatch.of(made.frames, made.stamps))
    [seconds] = timed([lambda: detector.detect(FrameBatch.of(made.frames, made.stamps))], repeats)
    return {
        'n_trajectories': len(result.found),
        'peak_memory_bytes': peak_memory(),
        'peak_memory_before_bytes': before,
        'detection': summary(seconds),
    }


def _measure_stages(made: SimulatedRecording, options: DetectorOptions,
                    repeats: int) -> dict[str, Any]:
    """Measure the stages of a search on one thread, and a copy of one weight for each state."""
    shape = made.frames.shape[1:]
    graph = ConvexDetector(options).graph(made.stamps, shape)
    psf = GaussianPsf(options.psf_sigma_px)
    grid = grid_shape(psf, shape)
    table = ViterbiTable(graph, grid)
    measured = psf.scores(graph, shape, amplitude_model(
        options.amplitudes, options.amplitude_model), RowThreads(grid[0], 1))
    scores = measured.scores(made.frames)
    table.fill(scores)
    filtering, searching, layer = timed(
        [lambda: measured.scores(made.frames), lambda: table.fill(scores),
         path_search.copying(graph, grid)], repeats)
    return path_search.compared(graph, grid,
                                 {'matched_filter': filtering, 'path_search': searching}, layer)


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('frames', 'scene', 'found', 'detection', 'its CPU', 'scores*', 'search*',
             'ns/state*', 'detection/copy', 'scores/copy*', 'search/copy*', 'peak MiB')]
    for case in measured['cases']:
        ratio = case['over_volume_copy']
        rows.append((
            f'{case["n_frames"]} x {case["width_px"]} x {case["height_px"]}', case['name'],
            str(case['n_trajectories']), _ms(case['detection']['wall_s']),
            _ms(case['detection']['cpu_s']), _ms(case['matched_filter']['wall_s']),
            _ms(case['path_search']['wall_s']), f'{1e9 / case["states_per_s"]:.2f}',
            *(f'{ratio[stage]:.2f}' for stage in ('detection', 'matched_filter', 'path_search')),
            f'{case["peak_memory_bytes"] / 2**20:.0f}'))
    sizes = '; '.join(dict.fromkeys(
        f'{case["width_px"]} x {case["height_px"]} px: {case["n_segments"]} segments x '
        f'{case["n_velocities"]} velocities x {case["n_positions"]} positions'
        for case in measured['cases']))
    lines = [
        *aligned(rows), '',
        f'Times in ms, least of {measured["repeats"]} (median in brackets); * on one thread.',
        f'A state is a position and a velocity in one frame ({sizes}); "copy" is that of the',
        'score volume, a float for each of them.']
    if measured['searches']:
        alone = [('grid', 'search alone*', 'ms', 'ns/state', 'ns/weight computed',
                 'over copy of volume', 'over copy of weights computed'),
                *path_search.search_rows(measured['searches'])]
        lines += ['', *aligned(alone)]
    return lines


def _ms(times: Mapping[str, float]) -> str:
    return in_ms(times, 1 if times['min'] < 0.1 else 0)


BENCH = Bench('convex', cases, _lines)
