"""What was found in batches as what JSON can hold, to the last bit."""

import base64
from collections.abc import Sequence
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from track_before_detect.tracking.pipeline import Unlinked
from track_before_detect.types import DetectionResult, Remark, Step, Trajectory

_KINDS = {kind.__name__: kind for kind in (Unlinked, DetectionResult, Trajectory, Step, Remark)}


def as_json(value: Any) -> Any:
    """Return numbers, text, arrays, and what of this package holds them, for JSON."""
    if isinstance(value, np.ndarray):
        return {'dtype': value.dtype.str, 'shape': value.shape,
                'bytes': base64.b64encode(value.tobytes()).decode()}
    if dataclasses.is_dataclass(value):
        return {'a': type(value).__name__, **{
            field.name: as_json(getattr(value, field.name))
            for field in dataclasses.fields(value)}}
    if isinstance(value, (list, tuple)):
        return [as_json(one) for one in value]
    return value.item() if isinstance(value, np.generic) else value


def as_ends(numbers: NDArray[np.int64]) -> list[int]:
    """Return the first and last of increasing numbers, and those between them that are missing."""
    first, last = int(numbers[0]), int(numbers[-1])
    return [first, last, *np.setdiff1d(np.arange(first, last + 1), numbers).tolist()]


def from_ends(ends: Sequence[int]) -> NDArray[np.int64]:
    """Return the numbers that :func:`as_ends` was told."""
    first, last, *missing = ends
    return np.setdiff1d(np.arange(first, last + 1), missing)


def from_json(value: Any) -> Any:
    """Return what :func:`as_json` was told; tuples come as lists."""
    if isinstance(value, list):
        return [from_json(one) for one in value]
    if not isinstance(value, dict):
        return value
    if 'bytes' in value:
        flat = np.frombuffer(base64.b64decode(value['bytes']), value['dtype'])
        return flat.reshape(value['shape'])
    return _KINDS[value['a']](**{
        name: from_json(one) for name, one in value.items() if name != 'a'})
