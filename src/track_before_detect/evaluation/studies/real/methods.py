"""The methods that are compared on real recordings, by name."""

from collections.abc import Mapping
from typing import Any

from track_before_detect.evaluation.studies.real.peers.registry import peers_installed
from track_before_detect.options import DetectorOptions

# Options of the detector. Limits of motion may be given per frame, for recordings of any rate.
METHODS: dict[str, Mapping[str, Any]] = {
    'no option': {},
    'README example': {
        'registration': 'translation', 'background': 'temporal_spatial_median',
        'noise': 'robust', 'psf_sigma_px': 2.0, 'max_speed_px_frame': 4.0,
        'max_acceleration_px_frame2': 0.16, 'batch_length': 20, 'hop': 10, 'threshold': 60.0},
}


def methods_and_peers() -> dict[str, Mapping[str, Any] | None]:
    """Return the options of each method, and None for each peer that is installed."""
    return {**METHODS, **dict.fromkeys(peers_installed())}


def options_at(method: Mapping[str, Any], interval_s: float) -> DetectorOptions:
    """Return the options of a method for frames that are ``interval_s`` seconds apart."""
    options = dict(method)
    for per_frame, per_second, power in (
            ('max_speed_px_frame', 'max_speed_px_s', 1),
            ('max_acceleration_px_frame2', 'max_acceleration_px_s2', 2)):
        if per_frame in options:
            options[per_second] = options.pop(per_frame) / interval_s**power
    return DetectorOptions.from_mapping(options)
