"""The peers by name."""

from collections.abc import Callable
import importlib
import importlib.util

from numpy.typing import NDArray

from track_before_detect.errors import named
from track_before_detect.tracking.recording import FrameSequence

Peer = Callable[[FrameSequence], list[NDArray]]

# The module that holds each, and the packages that it needs.
_PEERS = {
    'trackpy': ('trackpy_peer', ('trackpy',)),
    'MOG2 + norfair': ('mog2_norfair', ('cv2', 'norfair')),
    'white top-hat + link': ('white_top_hat', ('skimage', 'trackpy')),
}


def peers_installed() -> list[str]:
    """Return the names of the peers whose packages are there."""
    return [name for name, (_, packages) in _PEERS.items()
            if all(importlib.util.find_spec(package) for package in packages)]


def peer_named(name: str) -> Peer:
    """Return what is told the frames of a recording and returns positions (T, 2) of tracks."""
    module = importlib.import_module(f'{__package__}.{named("peer", name, _PEERS)[0]}')
    return module.find_tracks
