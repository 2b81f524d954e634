"""Runs of a study and their seeds."""

from __future__ import annotations

import hashlib

import numpy as np

from track_before_detect.errors import ParameterError


def checked_runs(runs: int, seed: int) -> None:
    """Refuse a number of runs or a seed that no study can be made with."""
    if runs < 1:
        raise ParameterError(f'runs must be at least 1, got {runs}')
    if seed < 0:
        raise ParameterError(f'seed must not be negative, got {seed}')


def run_seeds(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Return whole numbers that a spreadsheet can hold without rounding, one per run."""
    return [int(child.generate_state(1, np.uint64)[0] >> np.uint64(11))
            for child in sequence.spawn(count)]


def seeds_of(seed: int, name: str, count: int) -> list[int]:
    """Return the seeds of the runs of one part of a study.

    Parameters
    ----------
    seed : int
        Of the study.
    name : str
        Of the part; parts of different names are independent.
    count : int
        Number of runs; a larger number begins with the same seeds.
    """
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), '<u4')
    return run_seeds(np.random.SeedSequence([seed, *words.tolist()]), count)
