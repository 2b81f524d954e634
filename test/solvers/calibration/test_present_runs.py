"""Runs of frames in which paths of noise are present, beside random walks."""

import numpy as np
import pytest
from scipy.special import ndtr

from track_before_detect.models.amplitudes import Constant, NonNegative, Signed
from track_before_detect.models.presence import Presence, presence_for
from track_before_detect.solvers.calibration.present_runs import PresentRuns

N_FRAMES = 20


def test_there_are_as_many_runs_as_pairs_of_ends():
    runs = PresentRuns(N_FRAMES, Constant(), presence_for(Constant()))
    first, last = np.triu_indices(N_FRAMES)
    inside = 1 * (first > 0) + (last < N_FRAMES - 1)
    for length, ends, count in zip(runs.lengths, runs.ends, runs.counts, strict=True):
        assert count == np.sum((last - first + 1 == length) & (inside == ends))
    assert runs.counts.sum() == len(first)
    whole = PresentRuns(N_FRAMES, Constant(), None)
    assert (whole.lengths, whole.ends, whole.counts) == (N_FRAMES, 0, 1)


def test_level_of_the_whole_batch_is_that_of_a_target_in_every_frame():
    for model in (Constant(), NonNegative(), Signed()):
        presence = presence_for(model)
        runs = PresentRuns(N_FRAMES, model, presence)
        levels = runs.levels(9.0)
        assert levels[runs.lengths == N_FRAMES] == pytest.approx(9.0)
        assert (levels[runs.ends == 2] > levels[runs.ends == 1].min()).all()


def test_batches_of_white_noise_pass_with_some_run_as_often_as_walks_say():
    runs = PresentRuns(N_FRAMES, Constant(), Presence(0.0, entry=0.0, leaving=0.0))
    generator, n_batches = np.random.default_rng(5), 40_000
    walks = np.pad(np.cumsum(generator.standard_normal((n_batches, N_FRAMES)), axis=1),
                   ((0, 0), (1, 0)))
    best = np.max([(walks[:, length:] - walks[:, :-length]).max(axis=1) / length**0.5
                   for length in range(1, N_FRAMES + 1)], axis=0)
    for level in (3.0, 3.6):
        levels = runs.levels(level)
        expected = float(np.sum(runs.counts * runs.chances(levels) * ndtr(-levels)))
        found = -np.log1p(-np.mean(best > level))
        # Runs at the border of a batch have fewer neighbours that could be better.
        assert expected * 0.8 < found < expected * 1.2


@pytest.mark.parametrize('model', [NonNegative(), Signed()])
def test_no_run_ends_where_going_on_to_the_end_of_the_batch_is_cheaper(model):
    presence = presence_for(model)
    runs = PresentRuns(N_FRAMES, model, presence)
    chances = runs.chances(runs.levels(9.0))
    assert ((0 <= chances) & (chances <= 1)).all()
    cheaper = presence.per_frame * (N_FRAMES - runs.lengths) < presence.leaving
    assert (chances[(runs.ends == 1) & cheaper] == 0).all()
    assert (chances[(runs.ends == 1) & (N_FRAMES - runs.lengths > 10)] > 0).all()
    assert chances[0] == 1
