"""What was done with pixels and frames that hold no picture, said once over all batches."""

from collections.abc import Iterable
import logging

import numpy as np

from track_before_detect.types import Remark

_LOG = logging.getLogger(__name__)
_MOST_RUNS = 4


class Remarks:
    """Turns the remarks of overlapping batches into sentences, each said once."""

    def __init__(self) -> None:
        self._last_frame: dict[str, int] = {}

    def new(self, remarks: Iterable[Remark]) -> list[str]:
        """Return a sentence for each remark that says something new, and log it."""
        sentences = []
        for remark in remarks:
            last = self._last_frame.get(remark.kind)
            fresh = [frame for frame in remark.frames if last is None or frame > last]
            if last is None or fresh:
                sentences.append(remark.text.format(frames=_in_words(fresh)))
                _LOG.warning('%s', sentences[-1])
            self._last_frame[remark.kind] = max([-1 if last is None else last, *remark.frames])
        return sentences


def _in_words(frames: list[int]) -> str:
    """Return ascending frame numbers as a sentence names them."""
    if not frames:
        return ''
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    words = [f'{run[0]} to {run[-1]}' if len(run) > 1 else f'{run[0]}' for run in runs]
    if len(words) > _MOST_RUNS:
        return f'{len(frames)} frames from {words[0].split()[0]} to {frames[-1]}'
    return ('frames ' if len(frames) > 1 else 'frame ') + ', '.join(words)
