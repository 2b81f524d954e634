"""A search among cells first finds what a search of all states finds, to the last bit."""

import hypothesis
from hypothesis import strategies as st
import numpy as np
import pytest

from track_before_detect.models.motion.state_graph import build_state_graph
from track_before_detect.solvers.search import coarse_to_fine
from track_before_detect.solvers.search.coarse_to_fine import (
    cell_bytes,
    CellTable,
    CoarseToFine,
    path_table,
)
from track_before_detect.solvers.search.viterbi_table import table_bytes, ViterbiTable


def random_graph(generator, n_frames):
    """Return a graph of any speed and acceleration, frames lost in some."""
    stamps = np.cumsum(generator.choice([1.0, 1.0, 2.0], n_frames))
    return build_state_graph(
        stamps, step_px=float(generator.choice([0.5, 1.0])),
        max_speed=float(generator.choice([0.0, 0.6, 1.7])),
        max_acceleration=float(generator.choice([0.0, 0.1, 0.4, 1.5])),
        turn_cost=float(generator.choice([0.0, 0.5, 3.0])))


def random_scores(generator, n_frames, shape):
    """Return scores of noise, of either sign in some, with bright positions in others."""
    scores = generator.exponential(size=(n_frames, *shape)) - generator.choice([0.0, 1.0])
    if generator.random() < 0.5:
        y, x = (generator.integers(0, size, 2 * n_frames) for size in shape)
        scores[np.arange(2 * n_frames) % n_frames, y, x] += 30
    return scores.astype(np.float32)


@hypothesis.given(st.integers(0, 2**32 - 1))
@hypothesis.settings(max_examples=25)
def test_no_path_weighs_more_than_the_bound_of_its_cell(seed):
    generator = np.random.default_rng(seed)
    graph, shape = random_graph(generator, 7), tuple(generator.integers(1, 40, 2))
    scores = random_scores(generator, 7, shape)
    table, cells = ViterbiTable(graph, shape), CellTable(graph, shape)
    table.fill(scores)
    cells.fill(scores, 0.0)
    y, x = np.indices(shape) // 2
    assert (cells.best[y, x] >= table.best[0] - 1e-4).all()


@pytest.mark.parametrize('give_up', [True, False])
@pytest.mark.parametrize('seed', range(12))
def test_paths_are_those_of_a_search_of_all_states(monkeypatch, seed, give_up):
    if not give_up:
        # Not even where all states would be quicker to search than those that are marked.
        monkeypatch.setattr(coarse_to_fine, 'COST_OF_MARKED', 1e-3)
    generator = np.random.default_rng(seed)
    graph, shape = random_graph(generator, 7), tuple(generator.integers(1, 80, 2))
    whole = ViterbiTable(graph, shape)
    table = CoarseToFine(graph, shape, n_threads=int(generator.integers(1, 3)))
    for _ in range(3):
        scores = random_scores(generator, 7, shape)
        per_frame = float(generator.choice([0.0, 0.3]))
        largest = whole.fill(scores, per_frame)
        level = float(np.quantile(whole.best, generator.choice([0.9, 0.99, 1.0])))
        level += float(generator.choice([0.0, 5.0]))
        assert table.update(scores, level, None, per_frame) == largest
        for above in (level, level - 3):
            for found, known in zip(*(one.best_paths(above, 2, 9) for one in (table, whole)),
                                    strict=True):
                np.testing.assert_equal(found._asdict(), known._asdict())


@pytest.mark.parametrize('rise', [-4.0, 0.02, 3.0])
@pytest.mark.parametrize('seed', range(6))
def test_few_changed_scores_give_what_a_search_from_the_start_gives(monkeypatch, seed, rise):
    monkeypatch.setattr(coarse_to_fine, 'COST_OF_MARKED', 1e-3)
    generator = np.random.default_rng(seed)
    graph, shape = random_graph(generator, 7), tuple(generator.integers(20, 80, 2))
    scores = random_scores(generator, 7, shape)
    table = CoarseToFine(graph, shape)
    rows = None
    for _ in range(5):
        whole = ViterbiTable(graph, shape)
        largest = whole.fill(scores)
        level = float(np.quantile(whole.best, generator.choice([0.95, 1.0]))) + 0.1
        assert table.update(scores, level, rows) == largest
        for found, known in zip(*(one.best_paths(level, 2, 9) for one in (table, whole)),
                                strict=True):
            np.testing.assert_equal(found._asdict(), known._asdict())
        rows = np.zeros(scores.shape[:2], bool)
        scores = scores.copy()
        y, x = generator.integers(0, shape[0] - 9), generator.integers(0, shape[1] - 9)
        if generator.random() < 0.8:
            scores[:, y:y + 9, x:x + 9] += rise
            rows[:, y:y + 9] = True


def test_cells_of_fast_targets_take_less_than_half_of_the_memory():
    graph = build_state_graph(np.arange(20.0), step_px=0.5, max_speed=5.0, max_acceleration=0.167,
                              turn_cost=3.0)
    assert cell_bytes(graph, (511, 639)) < table_bytes(graph, (511, 639)) / 2


@pytest.mark.parametrize('most_bytes', [1e5, np.inf])
def test_cells_are_used_for_many_states_where_there_is_memory(most_bytes):
    graph = build_state_graph(np.arange(20.0), step_px=0.5, max_speed=5.0, max_acceleration=0.2,
                              turn_cost=3.0)
    table = path_table(graph, (255, 255), most_bytes=most_bytes)
    assert isinstance(table, CoarseToFine if most_bytes == np.inf else ViterbiTable)
    assert isinstance(path_table(graph, (9, 9)), ViterbiTable)


def test_targets_of_any_speed_up_to_one_pixel_a_frame_are_not_sought_among_cells():
    graph = build_state_graph(np.arange(20.0), step_px=0.5, max_speed=1.0, max_acceleration=1 / 30,
                              turn_cost=3.0)
    assert isinstance(path_table(graph, (1023, 1023)), ViterbiTable)


def test_batches_in_which_much_passes_are_searched_whole_until_cells_are_tried_again():
    graph = build_state_graph(np.arange(8.0), step_px=0.5, max_speed=1.0, max_acceleration=0.1,
                              turn_cost=3.0)
    quiet = np.zeros((8, 90, 200), np.float32)
    quiet[:, 40, 100] = 9
    crowded = quiet.copy()
    crowded[:, ::3] = 9
    table = CoarseToFine(graph, quiet.shape[1:])
    tried, kept = [], []
    for scores in [crowded] * 8 + [quiet] * 2 + [crowded] * 2:
        tried.append(table.cells_first)
        assert table.update(scores, 60.0) == 72.0
        kept.append(table.cells_first)
        table.forget()
        # Nothing was searched that could be told from.
        table.forget()
    # Each time in vain, twice as many are searched whole; but once only after a success.
    assert tried == [True] + 2 * [False] + [True] + 4 * [False] + 3 * [True] + [False]
    assert kept == 8 * [False] + 2 * [True] + 2 * [False]
