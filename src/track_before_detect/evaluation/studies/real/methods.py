"""The methods that are compared on real recordings, by name."""

from collections.abc import Mapping
from typing import Any

from track_before_detect.evaluation.studies.real.peers.registry import peers_installed
from track_before_detect.options import DetectorOptions
from track_before_detect.tracking.presets import choose_for, NONE
from track_before_detect.tracking.recording import FrameSequence

# Presets, and options that override theirs.
METHODS: dict[str, Mapping[str, Any]] = {'auto': {'preset': 'auto'}}


def methods_and_peers() -> dict[str, Mapping[str, Any] | None]:
    """Return the options of each method, and None for each peer that is installed."""
    return {**METHODS, **dict.fromkeys(peers_installed())}


def options_of(method: Mapping[str, Any], frames: FrameSequence) -> DetectorOptions:
    """Return the options of a method for a recording."""
    told = dict(method)
    return choose_for(frames, told.pop('preset', NONE), told).options
