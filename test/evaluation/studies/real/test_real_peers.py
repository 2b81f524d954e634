"""Each peer finds a bright target that moves over a quiet background."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.studies.real import runs as real_runs
from track_before_detect.evaluation.studies.real.peers.registry import (
    peer_named,
    peers_installed,
)

# What they warn of, mostly of each other's releases, is theirs to mend.
pytestmark = pytest.mark.filterwarnings('ignore')
N_FRAMES = 30


class Frames:
    """An array offered as a recording."""

    def __init__(self, frames):
        self._frames = frames
        self.stamps = np.arange(len(frames), dtype=float)

    def __len__(self):
        return len(self._frames)

    def __getitem__(self, index):
        return self._frames[index]


def crossing(brightness):
    """Return frames and the positions of the target in them."""
    frames = np.random.default_rng(4).normal(100, 1, (N_FRAMES, 60, 80))
    truth = np.column_stack([10 + 1.5 * np.arange(N_FRAMES), np.full(N_FRAMES, 30.0)])
    row, column = np.indices(frames.shape[1:])
    for frame, (x, y) in zip(frames, truth, strict=True):
        frame += brightness * np.exp(-((column - x)**2 + (row - y)**2) / (2 * 1.5**2))
    return Frames(frames), truth


@pytest.fixture(params=['trackpy', 'MOG2 + norfair', 'white top-hat + link'])
def peer(request):
    if request.param not in peers_installed():
        pytest.skip(f'{request.param} is not installed')
    return request.param


def test_a_bright_target_is_followed(peer):
    frames, truth = crossing(80)
    tracks = peer_named(peer)(frames)
    assert tracks
    errors = [np.linalg.norm(track - truth, axis=1) for track in tracks]
    assert all(track.shape == (N_FRAMES, 2) for track in tracks)
    assert max((error < 3).sum() for error in errors) >= 0.7 * N_FRAMES


def test_nothing_to_be_found(peer):
    assert peer_named(peer)(Frames(np.full((N_FRAMES, 40, 50), 100.0))) == []


def test_a_run_of_a_peer(peer, tmp_path):
    frames, truth = crossing(80)
    rows = np.column_stack([np.arange(N_FRAMES), np.zeros(N_FRAMES), truth])
    np.savez(tmp_path / 'one.npz', frames=frames[:], truth=rows, fps=10.0)
    row = real_runs.search({'data': str(tmp_path), 'recording': 'one', 'method': peer,
                            'options': None, 'snr': None, 'seed': 0})
    assert row['status'] == 'done'
    assert row['followed'] >= 0.7
    assert row['n_batches'] == 2
    assert row['seconds_per_frame'] > 0


def test_an_unknown_peer_is_refused():
    with pytest.raises(ParameterError, match=r"unknown peer 'trackpi'; did you mean trackpy\?"):
        peer_named('trackpi')


def test_distances_are_those_of_norfair():
    norfair = pytest.importorskip('norfair')
    from norfair.distances import mean_euclidean

    from track_before_detect.evaluation.studies.real.peers.mog2_norfair import Distances
    places = np.random.default_rng(5).normal(0, 20, (2, 12, 1, 2))
    detections = [norfair.Detection(place) for place in places[0]]
    tracked = [SimpleNamespace(estimate=place) for place in places[1]]
    distances = Distances()
    for moved in range(2):
        distances.forget()
        for one in tracked:
            one.estimate = one.estimate + moved
        for seen, one in itertools.product(detections, tracked):
            assert distances.between(seen, one) == pytest.approx(mean_euclidean(seen, one))
