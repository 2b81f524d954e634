from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import stats

from track_before_detect.errors import ParameterError
from track_before_detect.evaluation.metrics.confidence import (
    bootstrap_interval,
    poisson_interval,
    wilson_interval,
)


@st.composite
def proportions(draw):
    trials = draw(st.integers(1, 5000))
    return draw(st.integers(0, trials)), trials


@given(proportions(), st.floats(0.5, 0.999))
def test_wilson_interval_is_scipys(proportion, level):
    expected = stats.binomtest(*proportion).proportion_ci(level, method='wilson')
    assert wilson_interval(*proportion, level) == pytest.approx(
        (expected.low, expected.high), abs=1e-12)


def test_wilson_interval_is_of_95_per_cent_unless_told():
    assert wilson_interval(3, 40) == wilson_interval(3, 40, 0.95)
    assert wilson_interval(0, 9)[0] == 0.0 and wilson_interval(9, 9)[1] == 1.0


@given(st.integers(0, 200), st.floats(0.1, 1000.0))
def test_poisson_interval_leaves_half_of_the_rest_on_either_side(count, exposure):
    low, high = poisson_interval(count, exposure, 0.9)
    assert stats.poisson.cdf(count, high * exposure) == pytest.approx(0.05, abs=1e-9)
    if count:
        assert stats.poisson.sf(count - 1, low * exposure) == pytest.approx(0.05, abs=1e-9)
    else:
        assert low == 0.0


def test_bootstrap_interval_of_a_mean_is_near_the_normal_one():
    values = np.random.default_rng(0).normal(3.0, 2.0, 400)
    low, high = bootstrap_interval(values, lambda drawn: float(drawn.mean()))
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.2 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.2 * half)


def test_bootstrap_keeps_the_numbers_of_a_run_together_and_repeats_with_its_seed():
    runs = np.column_stack([np.arange(1.0, 21.0), 2 * np.arange(1.0, 21.0)])
    ends = bootstrap_interval(runs, lambda drawn: float(drawn[:, 1].sum() / drawn[:, 0].sum()))
    assert ends == pytest.approx((2.0, 2.0))

    def mean(drawn):
        return float(drawn.mean())

    assert bootstrap_interval(runs, mean, 3) == bootstrap_interval(runs, mean, 3)
    assert bootstrap_interval(runs, mean, 3) != bootstrap_interval(runs, mean, 4)


@pytest.mark.parametrize(
    ('call', 'said'),
    [(lambda: wilson_interval(1, 0), 'got 1 of 0'),
     (lambda: wilson_interval(5, 4), 'got 5 of 4'),
     (lambda: wilson_interval(1, 2, 1.0), 'level must be between 0 and 1, got 1'),
     (lambda: poisson_interval(-1), 'got -1'),
     (lambda: poisson_interval(1, 0.0), 'exposure above 0'),
     (lambda: bootstrap_interval([], np.mean), 'at least 1 run')])
def test_what_has_no_interval_is_refused(call, said):
    with pytest.raises(ParameterError, match=said):
        call()
