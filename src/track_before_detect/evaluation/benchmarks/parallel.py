"""Time of target cancellation over the whole transition set (MT) and by direction (PC).

The scenes are the six targets of Guo et al. 2018, section 4.2, at 8 dB, and 24 targets in frames
of 512 x 512 cells. Both methods have the same probability of a false alarm, and both compute again
only what depends on a cancelled target. Beside the candidates they look at stand those of
computing everything again, which Eq. 18 is about.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import functools
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.evaluation.benchmarks.bench import Bench, SEED
from track_before_detect.evaluation.engine.tables import aligned
from track_before_detect.evaluation.engine.timing import in_ms, summary, timed
from track_before_detect.evaluation.metrics.paper_metrics import track_errors
from track_before_detect.evaluation.studies.parallel import scenes as parallel_scenes
from track_before_detect.evaluation.studies.parallel.scenes import ParallelScene
from track_before_detect.models.measurement.psf import GaussianPsf
from track_before_detect.models.motion.transition_sets import directional_sets, TransitionSets
from track_before_detect.solvers.calibration.noise_study import noise_frames
from track_before_detect.solvers.cancellation.target_cancellation import TargetSearch
from track_before_detect.solvers.pixel_statistics import exclusion_levels, measure, Merit

SNR_DB = 8.0
P_FA = 0.1
N_DIRECTIONS = 4
POINT = GaussianPsf(0.3)
MERIT = Merit(squared=True)

_ms = functools.partial(in_ms, digits=2)


@dataclass(frozen=True)
class Case:
    """A scene, and how often it is drawn for the threshold and for P_d."""

    name: str
    shape: tuple[int, int]
    draw: Callable[[np.random.Generator], ParallelScene]
    noise_runs: int
    runs: int

    def measure(self, repeats: int) -> dict[str, Any]:
        """Measure both methods."""
        rng = np.random.default_rng(SEED)
        reaches = [1] * parallel_scenes.N_FRAMES
        sets = {'mt_dp': directional_sets(reaches, 1),
                'pc_dp': directional_sets(reaches, N_DIRECTIONS)}
        noise = [_search(noise_frames(rng, (parallel_scenes.N_FRAMES, *self.shape), True))
                 for _ in range(self.noise_runs)]
        bounds = {name: float(np.quantile([search.largest_merit(parts) for search in noise],
                                          1 - P_FA)) for name, parts in sets.items()}
        del noise
        first = self.draw(rng)
        scenes = itertools.chain([first], (self.draw(rng) for _ in range(self.runs - 1)))
        runs = [{name: _outcome(_search(scene.frames), scene, parts, bounds[name])
                 for name, parts in sets.items()} for scene in scenes]
        return {
            'name': self.name,
            'shape': list(self.shape),
            'n_targets': len(first.positions),
            'runs': self.runs,
            **{key: {name: float(np.mean([run[name][key] for run in runs])) for name in sets}
               for key in ('detected', 'tracks', 'candidates', 'candidates_of_slowest', 'plain',
                           'plain_of_slowest')},
            'eq_18': float(np.mean([run['pc_dp']['found_of_most']
                                    / (max(run['mt_dp']['found_of_most'], 1) * N_DIRECTIONS)
                                    for run in runs])),
            'times': _times(first, sets, bounds, repeats),
        }


CASES = (
    Case('six targets', parallel_scenes.SHAPE,
         lambda rng: parallel_scenes.six_targets(SNR_DB, rng), 2000, 300),
    Case('24 targets', (512, 512),
         lambda rng: parallel_scenes.many_targets(24, SNR_DB, rng, (512, 512)), 100, 10),
)
Sets = Mapping[str, Sequence[TransitionSets]]


def _search(frames: NDArray) -> TargetSearch:
    return TargetSearch(measure(frames, POINT), exclusion_levels(POINT), MERIT)


def _outcome(search: TargetSearch, scene: ParallelScene, parts: Sequence[TransitionSets],
             bound: float) -> dict[str, Any]:
    """Return what a method finds and looks at."""
    searches = search.run_parallel(parts, bound, 1)
    tracks = searches[0].tracks if len(parts) == 1 else search.fuse(searches, bound)
    # Everything once, and once more for each target found.
    cells = scene.frames[1:].size
    plain = [cells * int(part.sizes[part.sets[-1]]) * (1 + len(done.tracks))
             for part, done in zip(parts, searches, strict=True)]
    looked_at = [done.n_candidates for done in searches]
    return {
        'detected': track_errors([track.pixels for track in tracks],
                                 scene.cells).detected.mean(),
        'tracks': len(tracks),
        'candidates': sum(looked_at), 'candidates_of_slowest': max(looked_at),
        'plain': sum(plain), 'plain_of_slowest': max(plain),
        'found_of_most': max(len(done.tracks) for done in searches),
    }


def _times(scene: ParallelScene, sets: Sets, bounds: Mapping[str, float],
           repeats: int) -> dict[str, Any]:
    """Return times of the stages, which take turns."""
    search = _search(scene.frames)

    def whole() -> None:
        search.run_parallel(sets['mt_dp'], bounds['mt_dp'], 1)

    def by_direction(n_threads: int) -> Callable[[], None]:
        def run() -> None:
            bound = bounds['pc_dp']
            search.fuse(search.run_parallel(sets['pc_dp'], bound, n_threads), bound)

        return run

    stages = {'statistic': lambda: _search(scene.frames), 'mt_dp': whole,
              'pc_dp, 1 thread': by_direction(1), 'pc_dp, 2 threads': by_direction(2)}
    return {name: summary(seconds) for name, seconds in
            zip(stages, timed(list(stages.values()), repeats), strict=True)}


def _lines(measured: Mapping[str, Any]) -> list[str]:
    rows = [('scene', 'cells', 'method', 'P_d', 'tracks', 'candidates', 'slowest part', 'over MT',
             'plain', 'slowest part', 'over MT', 'Eq. 18', '1 thread', 'its CPU', '2 threads')]
    for case in measured['cases']:
        for name in ('mt_dp', 'pc_dp'):
            alone = case['times'][name if name == 'mt_dp' else 'pc_dp, 1 thread']
            pc = name == 'pc_dp'
            rows.append((
                case['name'], ' x '.join(map(str, case['shape'])), name,
                f'{100 * case["detected"][name]:.1f} %', f'{case["tracks"][name]:.1f}',
                _millions(case['candidates'][name]),
                _millions(case['candidates_of_slowest'][name]),
                _ratio(case, 'candidates_of_slowest', name),
                _millions(case['plain'][name]), _millions(case['plain_of_slowest'][name]),
                _ratio(case, 'plain_of_slowest', name), f'{case["eq_18"]:.3f}' if pc else '',
                _ms(alone['wall_s']), _ms(alone['cpu_s']),
                _ms(case['times']['pc_dp, 2 threads']['wall_s']) if pc else ''))
    statistic = ', '.join(f'{_ms(case["times"]["statistic"]["wall_s"])} for {case["name"]}'
                          for case in measured['cases'])
    return [
        *aligned(rows),
        f'{measured["snr_db"]:g} dB, P_fa = {measured["p_fa"]:g}; candidates in millions, plain: '
        'with everything computed again for each target.',
        f'Times in ms, least of {measured["repeats"]} (median in brackets), without the matched '
        f'filter that both share: {statistic}.']


def _ratio(case: Mapping[str, Any], key: str, name: str) -> str:
    return '' if name == 'mt_dp' else f'{case[key][name] / case[key]["mt_dp"]:.3f}'


def _millions(count: float) -> str:
    return f'{count / 1e6:.3f}'


# Frames of 512 x 512 cells are always measured.
BENCH = Bench('parallel', lambda large: {'cases': CASES}, _lines,
              lambda: {'snr_db': SNR_DB, 'p_fa': P_FA})
