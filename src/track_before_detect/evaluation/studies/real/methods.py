"""The methods that are compared on real recordings, by name."""

from collections.abc import Mapping, Sequence
from typing import Any

from track_before_detect.capabilities import capability
from track_before_detect.errors import named
from track_before_detect.evaluation.studies.real.peers.registry import peers_installed
from track_before_detect.options import DetectorOptions, DETECTORS
from track_before_detect.tracking.presets import choose_for, NONE
from track_before_detect.tracking.recording import FrameSequence

# Seconds for a batch of a baseline: its threshold is that of noise, which much of a scene passes.
MOST_SECONDS = 2.0


def _baseline(name: str) -> dict[str, Any]:
    """Return what a detector is told to search frames that are prepared as those of all others."""
    ends_by_itself = any(limit.option == 'max_time_s' for limit in capability(name).limits)
    return {'preset': 'auto', 'detector': name,
            **({} if ends_by_itself else {'max_time_s': MOST_SECONDS})}


# Presets, and options that override theirs.
METHODS: dict[str, Mapping[str, Any]] = {
    'auto': {'preset': 'auto'}, **{name: _baseline(name) for name in DETECTORS[1:]}}


def methods_and_peers(names: Sequence[str] = ()) -> dict[str, Mapping[str, Any] | None]:
    """Return the options of each method, and None for each peer that is installed.

    Parameters
    ----------
    names : sequence of str
        Those that are wanted; all unless given.

    Raises
    ------
    ParameterError
        There is no such method, or no such peer is installed.
    """
    known: dict[str, Mapping[str, Any] | None] = {**METHODS, **dict.fromkeys(peers_installed())}
    return {name: named('method', name, known) for name in names or known}


def options_of(method: Mapping[str, Any], frames: FrameSequence) -> DetectorOptions:
    """Return the options of a method for a recording."""
    told = dict(method)
    return choose_for(frames, told.pop('preset', NONE), told).options
