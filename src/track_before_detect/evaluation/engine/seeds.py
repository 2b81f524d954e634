"""Seeds of the runs of a study, and the items that are made of them."""

import hashlib
from typing import Any

import numpy as np


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


def items_of(seed: int, name: str, count: int, **same: Any) -> list[dict[str, Any]]:
    """Return the items of the runs of one part, which differ in their ``seed`` alone."""
    return [{**same, 'seed': one} for one in seeds_of(seed, name, count)]
