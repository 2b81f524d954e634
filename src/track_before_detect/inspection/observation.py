"""What is kept of a search while it runs."""

import numpy as np
from numpy.typing import NDArray

from track_before_detect import geometry
from track_before_detect.inspection.batch_facts import BatchFacts, facts_of
from track_before_detect.options import DetectorOptions
from track_before_detect.preprocess.registration.registration import register, Registration
from track_before_detect.tracking.pipeline import Searched
from track_before_detect.types import FrameBatch


class Observation:
    """Collects what a :class:`TrackingPipeline` shows.

    Parameters
    ----------
    middle : int
        Frame that is pictured.

    Attributes
    ----------
    facts : dict of str to list of BatchFacts
        Of each background, in the order of the search.
    views : list of Searched
        The batch that holds the middle frame deepest inside, once for each background.
    """

    def __init__(self, middle: int):
        self.middle = middle
        self.facts: dict[str, list[BatchFacts]] = {}
        self.views: list[Searched] = []
        # Of each frame number: motion of the scene since the one before, and whether it is sure.
        self._motion: dict[int, tuple[NDArray, bool]] = {}

    def __call__(self, searched: Searched) -> None:
        """Note a batch."""
        batch, prepared = searched.batch, searched.prepared
        self.facts.setdefault(searched.background, []).append(facts_of(prepared, searched.result))
        if prepared.registration is not None:
            self._note_motion(batch, prepared.registration)
        distance = self._distance(batch)
        nearest = self._distance(self.views[0].batch) if self.views else np.inf
        if distance < nearest:
            self.views = []
        if distance < nearest or batch is self.views[0].batch:
            self.views.append(searched)

    def add_motion_of_the_scene(self) -> None:
        """Register the batch that is pictured, where the search did not."""
        for view in self.views[:1]:
            if view.prepared.registration is None and not np.iscomplexobj(view.batch.frames):
                frames = np.asarray(view.batch.frames, np.float32)
                self._note_motion(view.batch, register(frames))

    @property
    def options(self) -> DetectorOptions:
        """What was searched with, whatever chose it."""
        return self.views[0].options

    def motion(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return frame numbers, the motion x, y of the scene in pixels, and which are sure."""
        numbers = sorted(self._motion)
        return (np.array(numbers, int),
                np.array([self._motion[k][0] for k in numbers]).reshape(-1, 2),
                np.array([self._motion[k][1] for k in numbers], bool))

    def strongest(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the middle frame of each batch, and its strongest path over the threshold."""
        best: dict[float, float] = {}
        for fact in self.all_facts():
            at = float(np.mean(fact.frames[[0, -1]]))
            best[at] = max(best.get(at, -np.inf), fact.strongest)
        return np.array(sorted(best)), np.array([best[at] for at in sorted(best)])

    def frames_searched(self) -> int:
        """Return how many frames any batch held."""
        return len({number for fact in self.all_facts() for number in fact.frames.tolist()})

    def all_facts(self) -> list[BatchFacts]:
        """Return the facts of all batches beside all backgrounds."""
        return [fact for facts in self.facts.values() for fact in facts]

    def whiteness(self, background: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the mean autocorrelation in space and in time beside a background."""
        means = []
        for one in ('in_space', 'in_time'):
            lags = [getattr(fact, one) for fact in self.facts[background]]
            longest = max(map(len, lags))
            means.append(np.mean([lag for lag in lags if len(lag) == longest], axis=0))
        return means[0], means[1]

    def _distance(self, batch: FrameBatch) -> float:
        middle = batch.frame_indices[len(batch) // 2]
        return abs(float(middle) - self.middle)

    def _note_motion(self, batch: FrameBatch, registration: Registration) -> None:
        height, width = batch.frames.shape[1:]
        centre = 0.5 * np.array([width - 1, height - 1])
        at = geometry.apply(registration.maps, np.broadcast_to(centre, (len(batch), 2)))
        for k in range(1, len(batch)):
            sure = bool(registration.credible[k] and registration.credible[k - 1])
            self._motion[int(batch.frame_indices[k])] = at[k] - at[k - 1], sure
