"""Time of the path search alone, beside a copy of what it computes, on one thread.

A state is a position and a velocity, and has a weight in every frame: these weights are the score
volume. A search over straight segments computes a weight for each state and segment only, so it is
measured by both: by the whole volume, which is what searching frame by frame would compute, and
by the weights it computes.
"""

from collections.abc import Callable, Mapping, Sequence
import dataclasses
from typing import Any

import numpy as np

from track_before_detect.evaluation.benchmarks.bench import CaseApart, SEED
from track_before_detect.evaluation.engine.timing import summary, timed
from track_before_detect.models.motion.state_graph import build_state_graph, StateGraph
from track_before_detect.solvers.search.viterbi_table import ViterbiTable

# Positions, and frames of a search frame by frame; fewer than a batch has, for memory.
GRID_SHAPE = (1024, 1280)
N_FRAMES = 8


def copying(graph: StateGraph, grid_shape: tuple[int, int]) -> Callable[[], object]:
    """Return a function that copies one weight for each state."""
    layer = np.ones((grid_shape[0], graph.n_velocities, grid_shape[1]), np.float32)
    # A first copy makes the system hand out the memory.
    copy = layer.copy()
    return lambda: np.copyto(copy, layer)


def compared(graph: StateGraph, grid_shape: tuple[int, int], stages: Mapping[str, Any],
             layer: Any) -> dict[str, Any]:
    """Return sizes, rates and ratios of a search.

    Parameters
    ----------
    graph : StateGraph
        What was searched.
    grid_shape : tuple of int
        (Y, X)
    stages : mapping
        Wall and CPU seconds of stages, shape (repeats, 2), ``path_search`` among them.
    layer : array, shape (repeats, 2)
        Of copying one weight for each state, in the same turns.
    """
    n_states = int(np.prod(grid_shape)) * graph.n_velocities
    search = stages['path_search'][:, 0]
    least = float(layer[:, 0].min())
    return {
        'n_segments': graph.n_segments,
        'n_velocities': graph.n_velocities,
        'n_positions': int(np.prod(grid_shape)),
        'n_states': n_states,
        'score_volume_bytes': 4 * n_states * graph.n_frames,
        'layer_copy': summary(layer),
        **{name: summary(seconds) for name, seconds in stages.items()},
        'states_per_s': float(n_states * graph.n_frames / search.min()),
        'computed_states_per_s': float(n_states * graph.n_segments / search.min()),
        'over_volume_copy': {name: float(seconds[:, 0].min() / (graph.n_frames * least))
                             for name, seconds in stages.items()},
        'search_over_copy_of_computed': {
            'of_minima': float(search.min() / (graph.n_segments * least)),
            'median': float(np.median(search / layer[:, 0]) / graph.n_segments)},
    }


@dataclasses.dataclass(frozen=True)
class SearchCase(CaseApart):
    """A search of random scores, frame by frame or in segments."""

    name: str
    n_frames: int
    grid_shape: tuple[int, int] = GRID_SHAPE

    def measure_here(self, repeats: int) -> dict[str, Any]:
        """Measure it in this process."""
        stamps = np.arange(float(self.n_frames))
        if self.n_frames == N_FRAMES:
            graph = build_state_graph(stamps, step_px=1.0, max_speed=2.4, max_acceleration=3.0,
                                      turn_cost=3.0)
            graph = dataclasses.replace(graph, reach=1)
        else:
            graph = build_state_graph(stamps, step_px=0.5, max_speed=1.0, max_acceleration=1 / 30,
                                      turn_cost=3.0)
        scores = np.random.default_rng(SEED).exponential(size=(self.n_frames, *self.grid_shape))
        scores = scores.astype(np.float32)
        table = ViterbiTable(graph, self.grid_shape)
        table.fill(scores)
        search, layer = timed(
            [lambda: table.fill(scores), copying(graph, self.grid_shape)], repeats)
        return {'name': self.name, 'n_frames': self.n_frames, 'reach': graph.reach,
                **compared(graph, self.grid_shape, {'path_search': search}, layer)}


SEARCHES = (SearchCase('25 velocities, segments of one frame', N_FRAMES),
            SearchCase('69 velocities, segments of seven frames', 20))


def search_rows(measured: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the measurements of searches as rows of a table."""
    return [(f'{case["n_positions"] / 1e6:.2f} M positions', case['name'],
             f'{1e3 * case["path_search"]["wall_s"]["min"]:.0f}',
             f'{1e9 / case["states_per_s"]:.2f}', f'{1e9 / case["computed_states_per_s"]:.2f}',
             f'{case["over_volume_copy"]["path_search"]:.2f}',
             f'{case["search_over_copy_of_computed"]["of_minima"]:.2f}') for case in measured]
