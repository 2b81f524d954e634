"""What a model of the amplitudes says fits together, and calibrations know it by the same text."""

import numpy as np
import pytest

from track_before_detect.models.amplitudes import amplitude_model, AMPLITUDE_MODELS
from track_before_detect.models.presence import presence_for

T = 9
NAMES = [type(model).__name__ for model in AMPLITUDE_MODELS]


def seen_by(model, seed):
    rng = np.random.default_rng(seed)
    seen = rng.standard_normal(T) + 1.0
    return seen + 1j * rng.standard_normal(T) if model.is_complex else seen


@pytest.mark.parametrize('model', AMPLITUDE_MODELS, ids=NAMES)
@pytest.mark.parametrize('seed', range(4))
def test_best_amplitudes_explain_the_squared_statistic(model, seed):
    seen = seen_by(model, seed)
    envelope = model.envelope(np.random.default_rng(9).uniform(0.2, 1.0, T))
    best = model.best(seen, envelope)
    explained = np.sum(np.abs(seen)**2) - np.sum(np.abs(seen - best)**2)
    assert explained == pytest.approx(model.statistic(seen, envelope)**2)
    assert model.norms(best[None], envelope[None])[0] == pytest.approx(np.linalg.norm(best))
    if model.non_negative:
        assert (best >= 0).all()


@pytest.mark.parametrize('model', AMPLITUDE_MODELS, ids=NAMES)
def test_a_path_passes_its_penalty_when_its_value_less_its_cost_passes_the_threshold(model):
    for statistic in (5.9, 6.1, 6.5, 7.0):
        for cost in (0.0, 0.4, 3.0, 20.0):
            passes = model.value(statistic) - cost > model.value(6.0)
            assert passes == (statistic > model.penalty(6.0, cost))
        assert model.from_value(model.value(statistic)) == pytest.approx(statistic)


def test_text_of_a_model_is_that_of_kept_calibrations():
    assert [str(model) for model in AMPLITUDE_MODELS] == [
        f'AmplitudeModel(code={code})' for code in range(6)]
    assert [str(amplitude_model(amplitudes, kind))
            for kind in ('fluctuating', 'constant')
            for amplitudes in ('non-negative', 'signed', 'complex')] == [
        f'AmplitudeModel(code={code})' for code in (0, 1, 4, 2, 3, 5)]
    assert str(presence_for(amplitude_model('complex', 'fluctuating'))) == (
        'Presence(per_frame=1.5, entry=6.0, leaving=6.0)')
