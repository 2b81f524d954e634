"""Stand-ins for what carries out the runs of a study."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from track_before_detect.evaluation.engine.runner import Runner


def quiet(label, done):
    assert label and 0 <= done <= 1


@dataclass(frozen=True)
class Canned(Runner):
    """Gives one threshold for all detectors, and answers in place of runs by the name of these."""

    progress: Callable = quiet
    answers: Mapping[str, Callable] = field(default_factory=dict)
    any_threshold: float = 7.9

    def threshold(self, options, shape):
        return options.get('threshold', self.any_threshold)

    def map(self, measure, items, label):
        if measure.__name__ not in self.answers:
            return super().map(measure, items, label)
        return [self.answers[measure.__name__](item) for item in items]
