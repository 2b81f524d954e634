"""The detector ``pc_dp``: target cancellation in several directions at once.

PC-DP-TBD of Guo et al. 2018, Section 3.2: the transition set is split by direction, each part is
searched as ``mt_dp`` searches the whole one, on threads, and the tracks of all parts are fused
where they coincide in more than half of their pixels. All parts share one threshold, calibrated on
the largest merit of any of them in noise.
"""

from __future__ import annotations

from collections.abc import Sequence

from track_before_detect.models.transition_sets import TransitionSets
from track_before_detect.solvers.batch_detector import BatchResult
from track_before_detect.solvers.cores import usable_cores
from track_before_detect.solvers.mt_dp import MtDpDetector
from track_before_detect.solvers.target_cancellation import TargetSearch


class PcDpDetector(MtDpDetector):
    """Finds targets over the parts of the transition set, one for each direction.

    Parameters
    ----------
    options : DetectorOptions
        As for ``mt_dp``.
    n_directions : int
        Parts of the transition set; four in the paper.
    """

    def __init__(self, options, n_directions: int = 4):
        super().__init__(options)
        self.n_directions = n_directions

    def solve(self, search: TargetSearch, directions: Sequence[TransitionSets],
              threshold: float, n_frames: int) -> BatchResult:
        """Find the targets of a batch."""
        bound = self.merit.bound(threshold, n_frames)
        searches = search.run_parallel(directions, bound, usable_cores())
        return self._result(search, searches, search.fuse(searches, bound), threshold)
