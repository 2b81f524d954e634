"""The detector ``pc_dp``: target cancellation in several directions at once.

PC-DP-TBD of Guo et al. 2018, Section 3.2: the transition set is split by direction, each part is
searched as ``mt_dp`` searches the whole one, on threads, and the tracks of all parts are fused
where they coincide in more than half of their pixels. All parts share one threshold, calibrated on
the largest merit of any of them in noise.
"""

from collections.abc import Sequence

from track_before_detect.models.motion.transition_sets import TransitionSets
from track_before_detect.options import DetectorOptions
from track_before_detect.parallel import usable_cores
from track_before_detect.solvers.batch_detector import BatchResult
from track_before_detect.solvers.cancellation.mt_dp import MtDpDetector
from track_before_detect.solvers.cancellation.target_cancellation import TargetSearch

DEFAULT_DIRECTIONS = 4


class PcDpDetector(MtDpDetector):
    """Finds targets over the parts of the transition set, one for each direction.

    Parameters
    ----------
    options : DetectorOptions
        As for ``mt_dp``, and the number of directions; four, as in the paper, unless given.
    """

    def __init__(self, options: DetectorOptions):
        super().__init__(options)
        self.n_directions = options.directions or DEFAULT_DIRECTIONS

    def solve(self, search: TargetSearch, directions: Sequence[TransitionSets],
              threshold: float, n_frames: int) -> BatchResult:
        """Find the targets of a batch."""
        bound = self.merit.bound(threshold, n_frames)
        searches = search.run_parallel(directions, bound, usable_cores())
        return self._result(search, searches, search.fuse(searches, bound), threshold)
